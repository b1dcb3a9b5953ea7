"""The full-space baseline: a graph network on the particles themselves.

Sanchez-Gonzalez et al. 2020 (ICML), thinned: a radius graph on every k-th soil particle and on all
rigid particles, its neighbour list made anew by scipy's KD-tree on the host in every step.

    lts train --model=full_space --data_path=datasets/excavation --raw_path=raw/excavation \\
        --model_path=my_model
    lts evaluate --data_path=datasets/excavation --raw_path=raw/excavation --model_path=my_model \\
        --output_path=my_rollouts

The dataset folder says which case is in which split; particles come from the raw runs, or, without
`--raw_path`, are decoded from the records (then truth and errors lie within the subspace). Errors
in metrics.json are those of the thinned particles; edges are the mean of all steps.
"""
