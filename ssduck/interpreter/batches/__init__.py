"""Programs over a batch: each expression is evaluated over all environments at once.

`columns` has the numbers of entities over environments, `kernels` the relations of shapes, contacts
and joints, `folds` the functions of time. `expressions` compiles an expression to a function of
these, and `evaluator` a program. What arrays cannot tell, an unknown value or an error, is asked of
each environment that needs it by itself.
"""
