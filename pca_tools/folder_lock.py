"""The lock of a folder; see `storage.folder_lock`, which the solver shares."""

from storage.folder_lock import LOCK_NAME, Owner, locked

__all__ = ['LOCK_NAME', 'Owner', 'locked']
