"""Result forms: the names after AS in a query, and the values that they make of the rows.

`registry` finds a form by its name. Each other module defines the forms of one topic, on top of
`base`. `result` holds the rows of raw SQL; `display` and `text_table` show values to people.
"""
