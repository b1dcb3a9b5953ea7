"""Drawing and exporting rollouts, for `render_rollout`: frames, views, curves, movies, ParaView."""
