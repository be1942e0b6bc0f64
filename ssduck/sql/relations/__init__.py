"""The relations between entities: one entry defines one relation.

A `Relation` has its parameters, its result, its formula, and its help. There is a module for each
topic: `entities`, `shapes`, `contacts`, `motion`, and `ode` for the names of the ODE dialect.
`registry` collects them.
"""
