"""The lock of a folder; see `pca_tools.storage.folder_lock`, which the solver shares."""

from pca_tools.storage.folder_lock import LOCK_NAME, Owner, locked

__all__ = ['LOCK_NAME', 'Owner', 'locked']
