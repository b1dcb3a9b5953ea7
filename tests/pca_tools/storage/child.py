"""A program that stays; see `test_parent`."""

import sys

from tests.pca_tools.storage import test_parent

if __name__ == '__main__':
    test_parent.wait_for_ever(sys.argv[1])
