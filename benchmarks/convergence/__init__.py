"""Error against wall time, Lobe beside Cycles: what a user waits for a picture of a given quality.

`tools/bench.py` is the command. Who does what, in the order of a run:

    plan       what to render: engines, Cycles' variants, levels of 4^k samples, what fits into the budget of seconds
    runs       rendering inside Blender, and the store of finished renders that lets an interrupted run go on
    worker     the process that renders: each round of seeds has one of its own
    reference  the picture that errors are measured against, from both engines, and how much noise it has itself
    campaign   one scene from first to last: probe, reference, pilot of Cycles' variants, levels, pictures
    analysis   from renders to figures: relMSE, bias, slopes, ratio of times at equal error with its interval
    tables     the rows of benchmarks/results/convergence.* and equal_error.*
    plot, pictures, page   what there is to look at

Nothing here knows what the engines do inside. A ratio above 1 means that Lobe is the faster.
"""
