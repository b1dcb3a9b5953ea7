"""Rollouts and live steps made fast: folded weights, two passes."""
