"""Suggests SelectScript for SQL that the language does not have."""

from __future__ import annotations

_JOIN = "only JOIN … ON … is known; write FROM room a, room b WHERE above(a, b)"
_SETS = "lists are joined by +: (SELECT … AS list) + (SELECT … AS list)"
_COMPARE = "write (SELECT … AS list), and IN, min or max of it"
_RAW = "only SQL has it: query the tables by ss.sql or ssduck query --sql"
_LIMIT_ADVICE = "write LIMIT n behind ORDER BY"
_CAST = "write int(x), float(x) or str(x)"
_MISSING = "there is no NULL; write x IS NULL, or x IS NOT NULL"
_INSTEAD = "write IF(x IS NULL; 0; x)"
_TIMES = "times are seconds of simulated time: getTime(), time(this)"
_AGGREGATES = "the aggregates are count, sum, min, max, avg, uniq; query others by ss.sql"
_TEXTS = "texts are compared exactly; find a part of one by 'part' IN text, or by LIKE"

_INSTEAD_OF: dict[tuple[str, ...], str] = {
    ("JOIN", "INNER", "LEFT", "RIGHT", "FULL", "OUTER", "CROSS", "NATURAL", "ON", "USING"): _JOIN,
    ("UNION", "INTERSECT", "EXCEPT", "MINUS"): _SETS,
    ("ANY", "SOME"): _COMPARE,
    ("EXISTS",): "write EXISTS (SELECT … FROM …)",
    ("OFFSET", "SKIP"): "write LIMIT n OFFSET m behind ORDER BY",
    ("FETCH", "TOP", "FIRST"): _LIMIT_ADVICE,
    ("NULLS",): "leave out the rows without a value: WHERE x IS NOT NULL",
    ("QUALIFY", "WINDOW", "OVER", "PARTITION", "ROLLUP", "CUBE", "PIVOT", "LATERAL"): _RAW,
    ("RANK", "DENSE_RANK", "ROW_NUMBER", "LAG", "LEAD", "NTILE", "GROUPING", "SETS"): _RAW,
    ("FILTER",): "write sum(CASE WHEN condition THEN 1 ELSE 0 END)",
    ("DATE", "TIMESTAMP", "INTERVAL", "EXTRACT"): _TIMES,
    ("INSERT", "UPDATE", "DELETE", "CREATE", "DROP", "ALTER", "MERGE", "TRUNCATE"): _RAW,
    ("COPY", "ATTACH", "PRAGMA", "SHOW", "DESCRIBE", "INSTALL"): _RAW,
    ("WITH",): "name the result of a query: rows = SELECT … AS list; SELECT … FROM rows",
    ("VALUES",): "write a list: FROM [[1, 2], [3, 4]]",
    ("ILIKE", "GLOB", "SIMILAR", "REGEXP", "RLIKE", "ESCAPE", "COLLATE"): _TEXTS,
    ("UPPER", "LOWER", "SUBSTRING", "SUBSTR", "TRIM", "STARTS_WITH"): _TEXTS,
    ("CAST", "TRY_CAST", "CONVERT"): _CAST,
    ("NULL", "NONE", "NIL"): _MISSING,
    ("COALESCE", "IFNULL", "NVL"): _INSTEAD,
    ("NULLIF",): "write IF(…; …; …)",
    ("CONCAT",): "texts are joined by +",
    ("LEN", "LENGTH"): "write count(list); a text's letters are counted in Python",
    ("POWER",): "write pow(x, y) or x ^ y",
    ("CEILING",): "write ceil(x)",
    ("MEAN", "AVERAGE"): "write avg(x)",
    ("ALL",): "leave ALL out: all rows are selected, unless DISTINCT is written",
    ("DISTINCT",): "write SELECT DISTINCT x, without brackets or ON, or uniq(x) with GROUP BY",
    ("WHEN", "THEN", "ELSE", "END"): "write CASE WHEN … THEN … ELSE … END, or IF(…; …; …)",
    ("NOTNULL", "ISNULL"): "write x IS NOT NULL, or x IS NULL",
    ("AND",): "a condition stands on both sides of AND",
    ("IS",): "write x IS NULL, or == to compare",
    ("!",): "write NOT",
    ("&", "&&"): "write AND",
    ("|", "||"): "write OR between conditions; texts are joined by +",
    (":", "::"): _CAST,
    ("`",): "names are written without quotes",
    ("~", "~~"): "write LIKE",
    ("{",): "no braces here; a world's past is kitchen{12.5}",
    ("?", "$"): "pass values as variables: ss.add_variable('name', value)",
}

HABITS = {word: suggestion for words, suggestion in _INSTEAD_OF.items() for word in words}

# The clauses behind FROM, in their order.
ORDER = "WHERE, START WITH … CONNECT BY … STOP WITH, GROUP BY, HAVING, ORDER BY, LIMIT, AS"
CLAUSES = frozenset(
    ("FROM", "WHERE", "START", "CONNECT", "STOP", "GROUP", "HAVING", "ORDER", "LIMIT")
)


# The words that begin statements of SQL, but not of SelectScript.
STATEMENTS = frozenset(
    (
        *("INSERT", "UPDATE", "DELETE", "CREATE", "DROP", "ALTER", "MERGE", "TRUNCATE"),
        *("COPY", "ATTACH", "PRAGMA", "SHOW", "DESCRIBE", "INSTALL", "WITH", "TOP"),
    )
)
# The words that mean SQL even where a name is possible.
_NAMES = frozenset(
    (
        *("ANY", "SOME", "EXISTS", "NULL", "NONE", "NIL", "ALL", "DISTINCT", "CAST", "TRY_CAST"),
        *("CONVERT", "COALESCE", "IFNULL", "NVL", "NULLIF", "CONCAT", "LEN", "LENGTH", "POWER"),
        *("CEILING", "MEAN", "AVERAGE", "UPPER", "LOWER", "SUBSTRING", "SUBSTR", "TRIM"),
        *("STARTS_WITH", "NOTNULL", "ISNULL"),
    )
)


_RANDOM = "a query gives the same result each time; draw numbers in Python"
_TABLE = "the tables are those of ss.sql; in a program the source is the world: FROM room"
# The suggestions for names of SQL that a program may use as its own.
_OWN_NAMES = {
    **dict.fromkeys(("RANDOM", "RAND"), _RANDOM),
    **dict.fromkeys(("ENTITIES", "SHAPES", "CONTACTS", "SENSINGS"), _TABLE),
    "JOINTS": "the position of one joint is joint(entity, 'name'); all are a table of ss.sql: "
    "SELECT name, position FROM joints",
    "TICKS": _TABLE,
    **dict.fromkeys(("NOW", "CURRENT_DATE", "CURRENT_TIME", "CURRENT_TIMESTAMP", "TODAY"), _TIMES),
    **dict.fromkeys(("DATE_PART", "DATEDIFF", "DATE_DIFF", "DATE_TRUNC", "STRFTIME"), _TIMES),
    **dict.fromkeys(("STDDEV", "STDDEV_POP", "STDDEV_SAMP", "VARIANCE", "VAR_POP"), _AGGREGATES),
    **dict.fromkeys(("MEDIAN", "QUANTILE", "MODE", "FIRST", "LAST", "ANY_VALUE"), _AGGREGATES),
    **dict.fromkeys(("STRING_AGG", "ARRAY_AGG", "GROUP_CONCAT", "LISTAGG"), _AGGREGATES),
    **dict.fromkeys(("LEFT", "RIGHT", "REPLACE", "REVERSE", "CONTAINS", "STRPOS"), _TEXTS),
    **dict.fromkeys(("CHAR_LENGTH", "INITCAP", "SPLIT_PART", "LPAD", "RPAD"), _TEXTS),
    "PI": "write 3.141592653589793",
    "LN": "write log(x), the natural logarithm",
    "LOG10": "write log(x) / log(10)",
    "TRUNC": "write int(x)",
    "ISNAN": "write x != x",
    "SIGN": "write CASE WHEN x > 0 THEN 1 WHEN x < 0 THEN -1 ELSE 0 END",
}


def suggestion_for_name(name: str) -> str:
    """Returns the suggestion for an unknown name; empty if it is no word of SQL."""
    if name.upper() in _OWN_NAMES:
        return _OWN_NAMES[name.upper()]
    return HABITS[name.upper()] if name.upper() in _NAMES else ""


def suggestion_for(word: str) -> str:
    """Returns the suggestion for a word or a sign of SQL; empty if there is none.

    >>> suggestion_for("coalesce")
    'write IF(x IS NULL; 0; x)'

    Args:
        word: as it is written; case does not matter.
    """
    word = word.upper()
    if word in CLAUSES:
        return f"the order of the clauses behind FROM is: {ORDER}"
    return HABITS.get(word, "")
