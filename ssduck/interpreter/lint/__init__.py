"""Probable mistakes in programs and raw SQL: what is valid, but hardly intended.

`statement_facts` finds the parts of a statement to look at, by `suspect_values` and
`misread_relations`; `linter` looks them up before the statement runs, and `known_names` whether
anything has a name.
"""
