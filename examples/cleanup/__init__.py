"""A robot that plans its motions and takes the cups from the kitchen's table to the sink.

`python -m examples.cleanup` runs it, in the folder that has `examples`; `--help` tells the options.
`program` selects the cups by a query, and tries one after the other. Its `Cleaner` (`cleaner`)
plans in the spaces of `spaces`, by the algorithms of `planning`, for the links of `kinematics`
among the shapes of `obstacles`; `driving` follows the paths by motors.
"""
