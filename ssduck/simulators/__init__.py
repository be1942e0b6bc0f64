"""The interface to simulators, and one folder for each simulator.

`interface` defines the protocol `Simulator` and the bodies, joints and poses that it exchanges.
`backends` lists the simulators by name, with the functions that make simulations. `scenes` reads
scene files. `partial` has a simulator in which nothing moves; it runs recorded ticks and what-if
worlds.
"""
