"""The order of the files: those with slow tests first."""


def pytest_collection_modifyitems(items):
    """A process that is given a slow file at the end works alone for a minute. Files go to
    processes in the order of collection (`run_scripts/test.sh`)."""
    slow = {item.path for item in items if item.get_closest_marker('slow')}
    items.sort(key=lambda item: item.path not in slow)
