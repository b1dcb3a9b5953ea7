"""Neural Relational Inference (Kipf et al. 2018, arXiv 1802.04687) in TensorFlow 2 and Sonnet.

Finds which nodes act on which from their trajectories alone. Letters:
S runs, V nodes, T frames, F features per node and frame, B samples in a batch, K edge types,
E = V (V - 1) ordered pairs. Pairs are listed row by row of the [receiver, sender] matrix without
its diagonal, which is Kipf's order.
"""
