"""The old name of `python -m reports edge_ablation`, kept for one release."""

from reports.__main__ import run

if __name__ == '__main__':
    run('edge_ablation')
