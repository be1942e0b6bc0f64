"""Suggests SelectScript for SQL that the language does not have."""

from __future__ import annotations

import re

_JOIN = "only JOIN … ON … is known; write FROM room a, room b WHERE above(a, b)"
_SETS = "lists are joined by +: (SELECT … AS list) + (SELECT … AS list)"
_IF = "a choice is IF(condition; a; b)"
_RAW = "only SQL has it: query the tables by ss.sql or ssduck query --sql"
_CHANGE = (
    "queries change no world: in Python, room['cup'].move([0, 0, 1]) moves an entity, and the rest "
    "are the simulator's own calls; tables of your own are changed by ss.sql"
)
_LIMIT_ADVICE = "write LIMIT n behind ORDER BY"
_CAST = "write int(x), float(x) or str(x)"
_MISSING = "there is no NULL; write x IS NULL, or x IS NOT NULL"
_TIMES = "times are seconds of simulated time: getTime(), time(this)"
_AGGREGATES = (
    "the aggregates are count, sum, min, max, avg, median, stddev, uniq; raw SQL has all of "
    'DuckDB: ss.sql("SELECT quantile_cont(z, 0.9) FROM entities")'
)
_EXISTS = "of any element write EXISTS (SELECT this FROM room WHERE condition)"
_ALL = "of all elements write NOT EXISTS (SELECT this FROM room WHERE NOT (condition))"
_PYTHON = (
    "a program has no statements of Python: a function of yours gets a name by "
    "ss.add_function('name', function)"
)
_TEXTS = "texts are compared exactly; find a part of one by 'part' IN text, or by LIKE"

# What to write instead of words that mean SQL even where a name is possible.
_OF_VALUES = {
    "ANY SOME": f"{_EXISTS}, of a list True IN list; x > ANY is x > min(SELECT …)",
    "EXISTS": "write EXISTS (SELECT … FROM …)",
    "UPPER LOWER SUBSTRING SUBSTR TRIM STARTS_WITH": _TEXTS,
    "CAST TRY_CAST CONVERT": _CAST,
    "NULL NONE NIL": _MISSING,
    "NAN INF INFINITY": "NaN is x != x, and infinity float('inf')",
    "COALESCE IFNULL NVL": "write IF(x IS NULL; 0; x)",
    "NULLIF": "write IF(…; …; …)",
    "CONCAT": "texts are joined by +",
    "LEN LENGTH": "write count(x), of a list or of the letters of a text",
    "POWER": "write pow(x, y) or x ^ y",
    "CEILING": "write ceil(x)",
    "MEAN AVERAGE": "write avg(x)",
    "ALL": f"{_ALL}, of a list NOT False IN list; x > ALL is x > max(SELECT …); behind "
    "SELECT and LIMIT leave ALL out",
    "DISTINCT": "write SELECT DISTINCT x, without brackets or ON, or uniq(x) with GROUP BY",
    "NOTNULL ISNULL": "write x IS NOT NULL, or x IS NULL",
}
# Of words that begin statements of SQL, but not of SelectScript.
_OF_STATEMENTS = {
    "INSERT UPDATE DELETE": _CHANGE,
    "CREATE DROP ALTER MERGE TRUNCATE": _RAW,
    "COPY ATTACH PRAGMA SHOW DESCRIBE INSTALL": _RAW,
    "WITH": "name the result of a query: rows = SELECT … AS list; SELECT … FROM rows",
    "TOP": _LIMIT_ADVICE,
}
# Of other words and signs.
_OF_WORDS = {
    "JOIN INNER LEFT RIGHT FULL OUTER CROSS NATURAL USING": _JOIN,
    "ON": f"{_JOIN}; of two entities write on(a, b)",
    "UNION INTERSECT EXCEPT MINUS": _SETS,
    "OFFSET SKIP": "write LIMIT n OFFSET m behind ORDER BY",
    "FETCH FIRST": _LIMIT_ADVICE,
    "NULLS": "leave out the rows without a value: WHERE x IS NOT NULL",
    "QUALIFY WINDOW OVER PARTITION ROLLUP CUBE PIVOT LATERAL": _RAW,
    "RANK DENSE_RANK ROW_NUMBER LAG LEAD NTILE GROUPING SETS": _RAW,
    "FILTER": "write sum(CASE WHEN condition THEN 1 ELSE 0 END)",
    "DATE TIMESTAMP INTERVAL EXTRACT": _TIMES,
    "VALUES": "write a list: FROM [[1, 2], [3, 4]]",
    "ILIKE GLOB SIMILAR REGEXP RLIKE ESCAPE COLLATE": _TEXTS,
    "MOD DIV": "write x % y for the remainder, floor(x / y) for the integer quotient",
    "OF": "a result form is one word, perhaps with arguments: AS dict, AS list, AS df, "
    "AS image(640, 480); help('AS') lists all",
    "WHILE DEF RETURN LAMBDA IMPORT DEL RAISE ASSERT": _PYTHON,
    "WHEN THEN ELSE END": "write CASE WHEN … THEN … ELSE … END, or IF(…; …; …)",
    "AND": "a condition stands on both sides of AND",
    "IS": "write x IS NULL, or == to compare",
    "!": "write NOT",
    "& &&": "write AND",
    "| ||": "write OR between conditions; texts are joined by +",
    "::": _CAST,
    ":": f"a part of a list is [p[0], p[1]], not p[0:2]; for a conversion {_CAST}",
    "`": "names are written without quotes",
    "~ ~~": "write LIKE",
    "{": "no braces here: a list is [1, 2, 3]; a world's past is kitchen{12.5}",
    "IF ?": _IF,
    "$": "pass values as variables: ss.add_variable('name', value)",
    "FOR": "the time for which a condition has held is heldFor(condition) >= 0.2; what holds of "
    "each entity of a world is SELECT z(this) FROM room",
    "IN": "IN looks into a list or a text, x IN (a, b); what is in a region is within(a, b)",
}


def _by_word(table: dict[str, str]) -> dict[str, str]:
    """Returns a table by single words."""
    return {word: text for words, text in table.items() for word in words.split()}


# What to write for signs of other languages.
SIGNS = {
    "=>": "write >=, or a IMPLIES b",
    "->": "write a IMPLIES b",
    "=<": "write <=",
    "===": "write ==",
    "**": "a power is x ^ y, or pow(x, y)",
    "+=": "write x = x + 1",
    "-=": "write x = x - 1",
    "++": "write x = x + 1",
    ":=": "write x = 1",
    ",": "numbers have a point: 0.1",
}
# What to write where the text between two tokens is that of other languages.
NO_COMMA = "leave the comma before it out"
NO_PREFIX = "a text has no letter before its quote; write 'a ' + str(x) for a text with a value"
NO_NUMBER = "a number is written 1000, 0.5 or 1e3"
NO_TUPLE = "a list is written in square brackets: [1, 2, 3]"
NO_BOUNDS = "bounds of time come last: always(condition, 0, 5)"
NUMPY = (
    "an array of NumPy is written array.tolist(), as in [0.1, 0.2, 0.3], or given as a parameter: "
    "ss.eval('distance(sim.cup, p);', {'p': array})"
)
_VALUES, STATEMENTS = _by_word(_OF_VALUES), _by_word(_OF_STATEMENTS)
HABITS = _VALUES | STATEMENTS | _by_word(_OF_WORDS)

# The clauses behind FROM, in their order.
ORDER = "WHERE, START WITH … CONNECT BY … STOP WITH, GROUP BY, HAVING, ORDER BY, LIMIT, AS"
CLAUSES = frozenset(
    ("FROM", "WHERE", "START", "CONNECT", "STOP", "GROUP", "HAVING", "ORDER", "LIMIT")
)

_TABLE = "SQL has tables (ss.sql, query --sql); in a program the source is the world: FROM room"
_JOINT = "the position of a joint is joint(entity, 'name')"
_JOINT_TABLE = 'is in the table of joints: ss.sql("SELECT name, {} FROM joints")'
_BOX = "aabb(e) is the bounding box [xmin, xmax, ymin, ymax, zmin, zmax]: aabb(e)[{}] - aabb(e)[{}]"
_ANGLE = (
    "between the orientations of two it is 2 * acos(min([1, abs(dot)])), with dot = "
    "sum([p[0] * q[0], p[1] * q[1], p[2] * q[2], p[3] * q[3]]) of p = orientation(a) and q = "
    "orientation(b)"
)
_NOT_KEPT = "a world does not keep it: bind a number of the simulator as a variable"
# The suggestions for names of SQL and of other libraries, and for words of time.
_OF_NAMES = {
    "RANDOM RAND": "a query gives the same result each time; draw numbers in Python",
    "ENTITIES SHAPES CONTACTS SENSINGS TICKS": _TABLE,
    "JOINTS": "the position of one joint is joint(entity, 'name'); all are a table of ss.sql: "
    "SELECT name, position FROM joints",
    "NOW CURRENT_DATE CURRENT_TIME CURRENT_TIMESTAMP TODAY": _TIMES,
    "DATE_PART DATEDIFF DATE_DIFF DATE_TRUNC STRFTIME": _TIMES,
    "ARRAY NDARRAY FLOAT64 FLOAT32 INT64 INT32 TENSOR ASARRAY": NUMPY,
    "FIRST": f"the first time at which a condition held is holds(condition)[0][0]; {_AGGREGATES}",
    "LAST": f"the last time at which a condition held is holds(condition)[-1][1]; {_AGGREGATES}",
    "LEFT RIGHT REPLACE REVERSE CONTAINS STRPOS": _TEXTS,
    "CHAR_LENGTH INITCAP SPLIT_PART LPAD RPAD": _TEXTS,
    "PI": "write 3.141592653589793",
    "LN": "write log(x), the natural logarithm",
    "LOG10": "write log(x) / log(10)",
    "TRUNC": "write int(x)",
    "ISNAN": "write x != x",
    "SIGN": "write CASE WHEN x > 0 THEN 1 WHEN x < 0 THEN -1 ELSE 0 END",
    "QUANTILE QUANTILE_CONT QUANTILE_DISC PERCENTILE MODE ANY_VALUE": _AGGREGATES,
    "STRING_AGG ARRAY_AGG GROUP_CONCAT LISTAGG HISTOGRAM ENTROPY": _AGGREGATES,
    "CORR COVAR_POP COVAR_SAMP SKEWNESS KURTOSIS PRODUCT PROD": _AGGREGATES,
    "STD STDEV STDDEV_SAMP": "write stddev(x), that of a sample",
    "STDDEV_POP PSTDEV": "write sqrt(avg(x ^ 2) - avg(x) ^ 2)",
    "VARIANCE VAR_SAMP": "write stddev(x) ^ 2, that of a sample",
    "VAR_POP PVARIANCE": "write avg(x ^ 2) - avg(x) ^ 2",
    "ARG_MAX ARGMAX MAX_BY": "write SELECT id FROM room ORDER BY z DESC LIMIT 1",
    "ARG_MIN ARGMIN MIN_BY": "write SELECT id FROM room ORDER BY z LIMIT 1",
    "RMS": "write sqrt(avg(x ^ 2)), or norm(list) / sqrt(count(list))",
    "TOTAL": "write sum(x)",
    "BOOL_AND EVERY FORALL": _ALL,
    "BOOL_OR": _EXISTS,
    "CLAMP": "write clip(x, low, high)",
    "MAXIMUM FMAX": "write max([a, b])",
    "MINIMUM FMIN": "write min([a, b])",
    "SQUARE": "write x ^ 2",
    "LOG2": "write log(x) / log(2)",
    "SIGMOID": "write 1 / (1 + exp(-x))",
    "DOT INNER": "write sum([a[0] * b[0], a[1] * b[1], a[2] * b[2]])",
    "CROSS": "write [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], "
    "a[0] * b[1] - a[1] * b[0]]",
    "MAGNITUDE": "write norm(list)",
    "DEGREES DEG RAD2DEG": "angles are radians; degrees are x * 180 / 3.141592653589793",
    "RADIANS RAD DEG2RAD": "write x * 3.141592653589793 / 180",
    "YAW HEADING": "write atan2(rot(e)[1][0], rot(e)[0][0])",
    "PITCH": "write asin(-rot(e)[2][0]); the angle to the vertical is tilt(e)",
    "ROLL": "write atan2(rot(e)[2][1], rot(e)[2][2]); the angle to the vertical is tilt(e)",
    "EULER RPY EULERFROMQUATERNION": "write [atan2(rot(e)[2][1], rot(e)[2][2]), "
    "asin(-rot(e)[2][0]), "
    "atan2(rot(e)[1][0], rot(e)[0][0])] for roll, pitch and yaw",
    "XPOS": "write position(e)",
    "ROTATION XQUAT QUATERNION": "write orientation(e), which is w, x, y, z, or rot(e), the matrix",
    "XMAT": "write rot(e)",
    "HEIGHT": "the height is z(e), the top is aabb(e)[5]; the extent is aabb(e)[5] - aabb(e)[4]",
    "BBOX BOUNDINGBOX": "aabb(e) is the bounding box [xmin, xmax, ymin, ymax, zmin, zmax]",
    "SIZE EXTENT EXTENTS DIMENSIONS WIDTH": _BOX.format(1, 0),
    "BASEPOSITIONANDORIENTATION POSITIONANDORIENTATION TRANSFORM": "write position(e) and "
    "orientation(e), which is w, x, y, z; pose(e) is both in one list",
    "BASEVELOCITY LINEARVEL LINVEL VEL": "write velocity(e); angularVelocity(e) is that of "
    "the turn",
    "ANGVEL ANGULARVEL OMEGA SPIN": "write angularVelocity(e)",
    "LINKSTATE LINKSTATES LINKPOSITION LINKPOSE EEPOSITION": "a link is written by "
    "its names: position(room.panda.hand), and likewise orientation and velocity",
    "DYNAMICSINFO BODYMASS": "write mass(e)",
    "NUMBODIES NUMLINKS": "write count(SELECT this FROM room), or count(links(e))",
    "NUMJOINTS JOINTINFO": f"{_JOINT}; its range {_JOINT_TABLE.format('lower, upper')}",
    "CONTACTPOINTS CONTACTPOINT": "inContact(a, b) asks for contacts that press, hasContact(a, "
    "b) for any; the points are a table of ss.sql: SELECT * FROM contacts",
    "MATRIXFROMQUATERNION": "write rot(e)",
    "STEPSIMULATION RESETBASEPOSITIONANDORIENTATION APPLYEXTERNALFORCE": _CHANGE,
    "QPOS JOINTPOSITION JOINTANGLE JOINTPOS JOINTSTATE JOINTSTATES": f"{_JOINT}, that of a body "
    "position(entity)",
    "QVEL JOINTVELOCITY JOINTVEL JOINTSPEED": "the velocity of a joint is "
    f"rate(joint(entity, 'name')), and {_JOINT_TABLE.format('velocity')}; that of a body is "
    "velocity(entity)",
    "JOINTLIMIT JOINTLIMITS JOINTRANGE": "the range of a joint "
    f"{_JOINT_TABLE.format('lower, upper')}",
    "ATLIMIT NEARLIMIT INLIMITS JOINTFRACTION": "write isOpen(entity, 'joint', share) "
    "or isClosed(entity, 'joint', share), of shares of the joint's range",
    "JOINTFORCE JOINTTORQUE JOINTEFFORT": f"the effort of a joint {_JOINT_TABLE.format('effort')}",
    "MOVING ISMOVING MOVED": "write speed(e) > 0.01, or NOT settled(e)",
    "ATREST STATIONARY STILL RESTING": "write settled(e), or speed(e) < 0.01",
    "STATIC ISSTATIC FIXED ISFIXED": "the mass of what nothing moves is 0: mass(e) == 0",
    "FALLEN TIPPED FLIPPED LYING": "write NOT upright(e), or tilt(e) > 0.5",
    "REACHED ARRIVED": "write distance(a, b) < 0.05",
    "DISTANCEXY DISTANCE2D HYPOT": "write norm([x(a) - x(b), y(a) - y(b)])",
    "STACKED STACKEDON ONTOPOF STACKEDONTOPOF PLACEDON SITSON STANDSON": "write on(support, "
    "thing), or restsOn(support, thing) for a stack: what carries comes first",
    "TOUCHES TOUCHED": "write touching(a, b), or inContact(a, b) for contacts that press",
    "UPSIDEDOWN INVERTED": "write tilt(e) > 2.8",
    "GAP SEPARATION": "write clearance(a, b)",
    "CLOSESTTO NEAREST NEARESTTO": "write SELECT id FROM room WHERE this != room.cup "
    "ORDER BY distance(this, room.cup) LIMIT 1",
    "CANSEE SEES SEEN LOOKSAT": "write isSensing(sensor, entity)",
    "ATTACHED WELDED CONSTRAINT": "what a gripper holds is grasped(a, b); the constraints "
    "of the simulator are not kept",
    "BETWEEN": "write x BETWEEN a AND b",
    "RANGE ARANGE LINSPACE": "a list is written [0, 1, 2]",
    "CLOSEST CLOSESTPOINTS": "the closest points of two are nearestPoints(a, b), and the gap is "
    "clearance(a, b)",
    "ANGLE ANGLEBETWEEN ANGULARDISTANCE ROTATIONDISTANCE": _ANGLE,
    "ORIENTATIONDISTANCE ALIGNED PARALLEL": _ANGLE,
    "XAXIS YAXIS ZAXIS UP": "the axes of e are the columns of rot(e): the z axis is "
    "[rot(e)[0][2], rot(e)[1][2], rot(e)[2][2]]",
    "ACCELERATION ACCEL": "write rate(velocity(e))",
    "DERIVATIVE DDT": "write rate(expression)",
    "DURATION TIMESINCE": "write heldFor(condition), or holds(condition) for the times",
    "ELAPSED": "the simulated time is getTime(); since a condition holds, heldFor(condition)",
    "COM CENTEROFMASS CENTREOFMASS COLOR COLOUR FRICTION INERTIA": _NOT_KEPT,
    "ENERGY MOMENTUM IMPULSE": _NOT_KEPT,
    "CTRL": "what an actuator is told is no part of the world: bind it, "
    "ss.add_variable('ctrl', list(data.ctrl))",
    "RANGES READING": "the readings of a sensor are Python's: world['name'].ranges; "
    "a program has isSensing(sensor, entity) and sensingAmount(sensor, entity)",
    "UNDER UNDERNEATH BENEATH": "write below(a, b)",
    "OVER": "write above(a, b)",
    "HOLDING GRASPING ISGRASPED": "write grasped(a, b)",
    "EVER SOMETIMES FINALLY": "write once(condition), or eventually(condition) of what follows",
    "GLOBALLY": "write always(condition), or historically(condition) of the past",
    "NEVER": "write historically(NOT (condition)), or always(NOT (condition)) of what follows",
    "MARGIN RHO ROBUST": "write robustness(condition)",
    "DELTA DIFF": "write x - previous(x), or rate(x) for the change in a second",
    "PREV LAG": "write previous(x)",
    "T SIMTIME CLOCK": "the simulated time is getTime()",
    "IIF IFELSE": _IF,
}
# Functions of other libraries that return a part of an entity.
_PARTS = frozenset(("LINK", "BODY", "SITE", "GEOM", "GETLINK", "GETBODY"))
_OF_PARTS = (
    "a link or a site is written by its names: room.panda.hand, or room['panda']['hand']; "
    "links(entity) is a list of all"
)
# The columns of SQL that are elements of a list here.
_ELEMENTS = {
    "aabb": ("XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX"),
    "velocity": ("VX", "VY", "VZ"),
    "angularVelocity": ("WX", "WY", "WZ"),
    "orientation": ("QW", "QX", "QY", "QZ"),
}
# The suggestions for names that a program may use as its own.
_OWN_NAMES = _by_word(_OF_NAMES) | {
    column: f"write {name}(e)[{number}]"
    for name, columns in _ELEMENTS.items()
    for number, column in enumerate(columns)
}

# What names of functions begin with in other libraries: getJointState, is_holding.
_PREFIX = re.compile(r"^(GET|IS|HAS|COMPUTE|CHECK)(?=[A-Z]{2})")


def plain_names(name: str) -> tuple[str, ...]:
    """Returns a name in upper case, without underscores, and without get or is in front.

    >>> plain_names("get_joint_state")
    ('GET_JOINT_STATE', 'GETJOINTSTATE', 'JOINTSTATE')
    """
    word = name.upper().replace("_", "")
    return name.upper(), word, _PREFIX.sub("", word)


def suggestion_for_name(name: str) -> str:
    """Returns the suggestion for an unknown name; empty if it is no word of SQL."""
    for word in plain_names(name):
        if word in _OWN_NAMES:
            return _OWN_NAMES[word]
    return _VALUES.get(name.upper(), "")


def suggestion_for_call(name: str) -> str:
    """Returns the suggestion for an unknown function; empty if it is no word of SQL."""
    return _OF_PARTS if name.upper() in _PARTS else suggestion_for_name(name)


def suggestion_for(word: str) -> str:
    """Returns the suggestion for a word or a sign of SQL; empty if there is none.

    >>> suggestion_for("coalesce")
    'write IF(x IS NULL; 0; x)'
    """
    word = word.upper()
    if word in CLAUSES:
        return f"the order of the clauses behind FROM is: {ORDER}"
    return HABITS.get(word, "")
