"""Networks on the scores of the modes and on the body: graph network, MLP, mixers.

One frame is `learned_simulator` (DeepMind's name), its inputs `features`, its networks
`graph_network` and `whole_state`; `method` is what `registry` calls.
"""
