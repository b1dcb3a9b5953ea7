"""What an inspection of a dataset folder collects: contents and findings."""

from __future__ import annotations

import dataclasses
import enum
from typing import Any

import numpy as np

from pca_tools.dataset import Trajectory


class Level(enum.Enum):
    """How bad a finding is."""

    OK = 'OK'
    WARN = 'WARN'
    ERROR = 'ERROR'


@dataclasses.dataclass(frozen=True)
class Finding:
    """One result of a check: a level and a sentence that says what is and what to do."""

    level: Level
    text: str


@dataclasses.dataclass
class Inspection:
    """What is in a dataset folder.

    Attributes:
        folder: the folder.
        metadata: its metadata, or None if unreadable.
        splits: split -> readable runs.
        findings: results of all checks.
        n_soil: N, or None if nothing says it.
        floors: truncation error in m^2 against the number of modes [S + 1], or None.
    """

    folder: str
    metadata: dict[str, Any] | None = None
    splits: dict[str, list[Trajectory]] = dataclasses.field(default_factory=dict)
    findings: list[Finding] = dataclasses.field(default_factory=list)
    n_soil: int | None = None
    floors: np.ndarray | None = None

    @property
    def runs(self) -> list[Trajectory]:
        """All readable runs of all splits."""
        return [run for part in self.splits.values() for run in part]

    @property
    def failed(self) -> bool:
        """True if any finding is an error."""
        return any(finding.level is Level.ERROR for finding in self.findings)

    def ok(self, text: str) -> None:
        """Adds a passed check."""
        self.findings.append(Finding(Level.OK, text))

    def warn(self, text: str) -> None:
        """Adds a defect that readers live with."""
        self.findings.append(Finding(Level.WARN, text))

    def error(self, text: str) -> None:
        """Adds a defect that makes the folder unusable."""
        self.findings.append(Finding(Level.ERROR, text))
