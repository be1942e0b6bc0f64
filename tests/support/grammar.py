"""Random programs of the language."""

from dataclasses import replace

from tests.support.choices import (
    AGED,
    COMPARISONS,
    ENTITY,
    FLAG,
    FLAG_RELATIONS,
    INT,
    INTS,
    LITERALS,
    NUMBER,
    PAIR_RELATIONS,
    REAL,
    REAL_RELATIONS,
    REALS,
    RECORD,
    SCALARS,
    TEXT,
    VARIABLES,
    WILD,
    Scope,
    Source,
    Type,
    list_of,
    reached,
)


class Grammar:
    """Makes the text of a program of choices.

    Args:
        choices: what decides.
    """

    def __init__(self, choices):
        self.c = choices
        self.wild = choices.chance(20)
        self.joins = not self.wild or choices.chance(35)
        self.aliases = 0
        self.before = []
        self.tally = choices.chance(5)
        self.worlds = 2
        self.size = choices.pick((1, 1, 2, 1))
        self.deepest = choices.pick((1, 1, 2, 1))

    # -- statements -------------------------------------------------------------------------

    def program(self):
        """Statements, the last of them a query or an expression."""
        variables = ((name, type_) for name, (_, type_) in VARIABLES.items())
        scope = Scope(variables=(*variables, *(AGED if self.c.chance(25) else ())))
        if self.c.chance(5):
            name, type_ = self.c.pick((("past", INT), ("trail", TEXT)))
            horizon = self.c.pick(("", "2.0", "0", "n"))
            value = self.expression(type_, scope, 2, 1)
            self.before.append(f"{name}{{{horizon}}} = {value}")
        kind = self.c.below(100)
        if kind < 62:
            last = self.query(scope, 0)
        elif kind < 75:
            last = self.hierarchy(scope, 0)
        elif kind < 85:
            last = self.deferred(scope)
        elif kind < 93:
            last = self.expression(self.c.pick((*SCALARS, INTS)), scope, 3, 1)
        else:
            last = self.stored(scope)
        if self.tally:
            self.before.insert(0, "tally = 0")
            last = f"[({last}), tally]"
        return " ".join(f"{statement};" for statement in (*self.before, last))

    def stored(self, scope):
        """Returns a query over the stored result of another query."""
        type_ = self.c.pick(SCALARS)
        self.before.append(f"found = {self.query(scope, 1, type_)}")
        alias = self.alias()
        source = Source(alias, "found", type_)
        return self.rest(scope, [source], 0, None)

    def deferred(self, scope):
        """Returns a list for the query that uses it, stored before that."""
        first, second = self.alias(), self.alias()
        lists = (list_of(INT), list_of(TEXT), list_of(REAL))
        type_ = self.c.pick(lists)
        element = type_.element
        assert element is not None
        names = (f"{first}.this", f"{second}.this")
        rows = [
            f"[{self.c.pick(names)}, {self.c.pick((*names, self.literal(element)))}]"
            for _ in range(1 + self.c.below(3))
        ]
        self.before.append(f"later = [{', '.join(rows)}]")
        atoms = tuple((name, element) for name in names)
        inner = replace(scope, outer=(*scope.outer, *atoms))
        self.worlds = 0
        name = self.alias()
        nested = self.rest(inner, [Source(name, "later", type_)], 1, self.c.pick((None, element)))
        condition = self.c.pick(
            (
                f"[] == {self.nested(nested)}",
                f"count({self.nested(nested)}) > {self.c.below(3)}",
                f"{names[0]} IN {self.nested(nested)}",
            )
        )
        sources = [Source(alias, self.list(element, scope), element) for alias in (first, second)]
        return self.rest(scope, sources, 0, None, where=condition)

    # -- queries ----------------------------------------------------------------------------

    def alias(self):
        """Returns a new name of a source; now and then a name that was used."""
        if self.aliases and self.c.chance(3):
            return "abcdefghijklmnopq"[self.c.below(min(self.aliases, 17))]
        self.aliases += 1
        return f"s{self.aliases}" if self.aliases > 17 else "abcdefghijklmnopq"[self.aliases - 1]

    def nested(self, text):
        return f"({text})"

    def query(self, scope, depth, wanted=None, form=""):
        """Returns a query; one with a column of a type, on request."""
        many = 1 + self.c.below(3 if depth == 0 else 2) if self.c.chance(45) else 1
        aliased = many > 1 or self.c.chance(60)
        sources = [self.source(scope, depth, aliased=aliased) for _ in range(many)]
        return self.rest(scope, sources, depth, wanted, form=form)

    def rest(
        self,
        scope,
        sources,
        depth,
        wanted,
        *,
        form="",
        where="",
    ):
        inner = self.inside(scope, sources)
        columns = self.columns(inner, sources, depth, wanted)
        distinct = "DISTINCT " if columns != ["*"] and self.c.chance(6) else ""
        parts = [
            f"SELECT {distinct}{', '.join(columns)} FROM {', '.join(s.written for s in sources)}"
        ]
        conditions = [where] if where else []
        if depth == 0 and self.tally and self.c.chance(70):
            conditions.append(self.counted(inner, depth + 1))
        if self.c.chance(60):
            conditions.append(self.expression(FLAG, inner, self.size, depth + 1))
            if self.joins and self.c.chance(25):
                conditions.append(self.expression(FLAG, inner, self.size, depth + 1))
        if conditions:
            parts.append(f"WHERE {' AND '.join(conditions)}")
        if depth == 0 and wanted is None and not distinct:
            if self.c.chance(12):
                parts.append(self.grouping(inner, sources))
            elif self.c.chance(10):
                return self.aggregated(parts, inner, sources)
        parts.extend(self.arranging(inner, sources))
        chosen = form or ("list" if wanted else self.c.pick(("list", "dict", "value", "list")))
        if chosen != "dict" or self.c.chance(30):
            parts.append(f"AS {self.c.pick((chosen, chosen, chosen.upper(), chosen.title()))}")
        return " ".join(parts)

    def aggregated(self, parts, inner, sources):
        """Returns a query of aggregates over the rows of its groups, or of all rows."""
        source = parts[0].split(" FROM ", 1)[1]
        found = [f"{self.aggregate(inner)} AS c{n}" for n in range(1 + self.c.below(2))]
        made = [f"SELECT count(*), {', '.join(found)} FROM {source}", *parts[1:]]
        if self.c.chance(60):
            made.append(self.grouping(inner, sources))
        elif self.c.chance(40):
            made.append(f"HAVING {self.aggregate(inner)} {self.c.pick(COMPARISONS)} 1")
        if self.c.chance(40):
            made.append(f"ORDER BY {self.aggregate(inner)}{self.c.pick(('', ' DESC'))}, count(*)")
        if self.c.chance(20):
            made.append(f"LIMIT {self.c.pick(('2', '1', '0'))}")
        return " ".join([*made, f"AS {self.c.pick(('list', 'dict', 'value'))}"])

    def aggregate(self, inner):
        name = self.c.pick(("count", "sum", "min", "max", "avg"))
        over = self.expression(self.c.pick((INT, REAL)), inner, 1, 9)
        kinds = (f"{name}({over})", "count(*)", f"count(DISTINCT {over})", f"{name}(uniq({over}))")
        return f"{self.c.pick(kinds)}{self.c.pick(('', ' + 1', ' * 2'))}"

    def arranging(self, inner, sources):
        if self.c.chance(30):
            keys = []
            for _ in range(1 + self.c.below(3)):
                names = self.names(sources, (INT, REAL, TEXT))
                if names and self.c.chance(30):
                    key = self.c.pick(names)
                else:
                    key = self.expression(self.c.pick((INT, REAL, TEXT)), inner, 1, 9)
                keys.append(key + self.c.pick(("", " DESC", " ASC", " DESCENDING")))
            yield f"ORDER BY {', '.join(keys)}"
        if self.c.chance(15):
            yield f"LIMIT {self.c.pick(('2', '1', '0', '5', 'n', 'n + 1', 'count(ints)'))}"

    def grouping(self, inner, sources):
        keys = []
        for _ in range(1 + self.c.below(2)):
            names = self.names(sources, SCALARS)
            if names and self.c.chance(30):
                keys.append(self.c.pick(names))
            else:
                keys.append(self.expression(self.c.pick(SCALARS), inner, 1, 9))
        text = f"GROUP BY {', '.join(keys)}"
        if not self.c.chance(50):
            return text
        sign, bound = self.c.pick(COMPARISONS), self.literal(self.c.pick((INT, REAL)))
        return f"{text} HAVING {self.aggregate(inner)} {sign} {bound}"

    def inside(self, scope, sources):
        """Returns the scope of a query's parts: its own sources, and the outer ones by alias."""
        outer = tuple(
            (text, type_)
            for text, type_ in (*scope.outer, *scope.own)
            if not text.startswith("this") and text not in ("level", "state")
        )
        taken = tuple(f"{source.this}" for source in sources)
        outer = tuple(entry for entry in outer if not entry[0].startswith(taken))
        own = [atom for source in sources for atom in reached(source.this, source.type)]
        return Scope(outer, tuple(own), scope.variables)

    def names(self, sources, types):
        """Bare names that mean something of the only source."""
        if len(sources) != 1:
            return []
        type_ = sources[0].type
        if type_ == ENTITY:
            known = (("id", TEXT), ("z", REAL), ("environmentID", INT), ("isRobot", FLAG))
            return [name for name, of in known if of in types]
        return [name for name, of in type_.keys if of in types]

    def columns(self, inner, sources, depth, wanted):
        if wanted is not None:
            return [self.expression(wanted, inner, self.size, depth + 1)]
        if self.c.chance(5):
            return ["*"]
        found = []
        for number in range(self.c.pick((1, 1, 2, 3))):
            names = [name for name in self.names(sources, SCALARS) if name not in found]
            if names and self.c.chance(40):
                found.append(self.c.pick(names))
                continue
            types = [*SCALARS, *{t for _, t in inner.own if t.kind != "dict"}]
            types.sort(key=repr)
            value = self.expression(self.c.pick(types), inner, self.size, depth + 1)
            found.append(f"to({value}, 'c{number}')")
        return found

    def source(self, scope, depth, *, aliased):
        alias = self.alias() if aliased else None
        kind = self.c.below(100)
        if kind < 38:
            type_ = self.c.pick((INT, REAL, TEXT, FLAG, INT, NUMBER))
            return Source(alias, self.list(type_, scope), INT if type_ == NUMBER else type_)
        if kind < 62 and self.worlds > 0:
            self.worlds -= 1
            return Source(alias, "w", ENTITY)
        if kind < 70:
            element = self.c.pick((INT, TEXT, REAL))
            rows = [self.pair(element, scope) for _ in range(1 + self.c.below(3))]
            return Source(alias, f"[{', '.join(rows)}]", list_of(element))
        if kind < 76:
            return Source(alias, "records", RECORD)
        if kind < 84 or depth >= self.deepest:
            lists = (("ints", INT), ("words", TEXT), ("pairs", INTS))
            aged = (("past{}", INT), ("trail{-2.0}", TEXT), ("past{n}", INT))
            name, type_ = self.c.pick(lists if self.c.chance(75) else aged)
            return Source(alias, name, type_)
        if kind < 96:
            type_ = self.c.pick((*SCALARS, ENTITY if self.worlds > 0 else INT))
            return Source(alias, self.nested(self.query(scope, depth + 1, type_, "list")), type_)
        if kind < 98:
            return Source(alias, *self.records(scope, depth))
        type_ = self.c.pick(SCALARS)
        return Source(alias, self.literal(type_), type_)

    def records(self, scope, depth):
        source = self.source(scope, 2, aliased=True)
        inner = self.inside(scope, [source])
        keys = (("k", INT), ("name", TEXT))
        columns = [f"to({self.expression(t, inner, 1, depth + 1)}, '{key}')" for key, t in keys]
        text = f"(SELECT {', '.join(columns)} FROM {source.written} AS dict)"
        return text, Type("dict", keys=keys)

    def list(self, element, scope):
        """Returns a list that is written out; of numbers of both kinds, if that is what it is of."""
        values = []
        for _ in range(self.c.below(5)):
            type_ = self.c.pick((INT, REAL)) if element == NUMBER else element
            atoms = [text for text, of in scope.outer if of == type_]
            if atoms and self.c.chance(40):
                values.append(self.c.pick(atoms))
            else:
                values.append(self.literal(type_))
        return f"[{', '.join(values)}]"

    def pair(self, element, scope):
        atoms = [text for text, of in scope.outer if of == element]
        values = [
            self.c.pick(atoms) if atoms and self.c.chance(40) else self.literal(element)
            for _ in range(2 + self.c.below(2))
        ]
        return f"[{', '.join(values)}]"

    # -- hierarchies ------------------------------------------------------------------------

    def hierarchy(self, scope, depth):
        """Returns a hierarchical query that a level bounds."""
        type_ = self.c.pick((INT, TEXT, INTS, REAL))
        aliased = self.c.chance(60)
        if self.c.chance(25):
            source = Source(self.alias() if aliased else None, "w", ENTITY)
        elif self.c.chance(40):
            source = Source(self.alias() if aliased else None, "pairs", INTS)
        else:
            element = self.c.pick((INT, TEXT, REAL))
            source = Source(self.alias() if aliased else None, self.list(element, scope), element)
        self.worlds = 0
        inner = self.inside(scope, [source])
        inner = replace(inner, own=(*inner.own, ("level", INT), ("state", type_), ("state", type_)))
        columns = self.columns(inner, [source], 8, None)
        if columns == ["*"]:
            columns = ["level"]
        parts = [f"SELECT {', '.join(columns)} FROM {source.written}"]
        if self.c.chance(60):
            parts.append(f"WHERE {self.expression(FLAG, inner, self.size, depth + 2)}")
        start = self.expression(type_, replace(inner, own=()), 1, 9)
        parts.append(f"START WITH level = 0, state = {start}")
        kind = self.c.pick(
            ("", "NO CYCLE", "UNIQUE", "MEMORIZE 3", "MEMORIZE 2", "NO CYCLE UNIQUE")
        )
        most = self.c.pick(("", "", "MAXIMUM 2", "MAXIMUM 1"))
        step = self.expression(type_, inner, 1, depth + 2)
        words = " ".join(filter(None, ("CONNECT BY", kind, most)))
        parts.append(f"{words} level = level + 1, state = {step}")
        stop = f"level >= {1 + self.c.below(2)}"
        if self.c.chance(35):
            stop = f"{stop} OR {self.expression(FLAG, inner, 1, depth + 2)}"
        parts.append(f"STOP WITH {stop}")
        if self.c.chance(10):
            parts.append(self.grouping(inner, [source]))
        if self.c.chance(30):
            parts.extend(self.arranging(inner, [source]))
        parts.append(f"AS {self.c.pick(('list', 'dict', 'value'))}")
        return " ".join(parts)

    # -- expressions ------------------------------------------------------------------------

    def literal(self, type_):
        if self.wild and type_.kind in WILD and self.c.chance(15):
            return self.c.pick(WILD[type_.kind])
        return self.c.pick(LITERALS[type_.kind])

    def expression(self, type_, scope, size, depth):
        """Returns an expression of a type; seldom of another one, if errors are allowed."""
        if self.wild and self.c.chance(4):
            type_ = self.c.pick((INT, TEXT, REAL, INTS, FLAG))
        if size <= 0 or not self.c.chance(95 if type_ == FLAG else 62):
            return self.atom(type_, scope)
        makers = {
            "int": self.integer,
            "real": self.real,
            "text": self.text,
            "flag": self.flag,
        }
        if type_.kind in makers and self.c.chance(1):
            return f"({self.chain(type_, scope)})"
        if type_.kind in makers:
            return f"({makers[type_.kind](scope, size - 1, depth)})"
        return self.atom(type_, scope) if type_.kind != "list" else self.listed(type_, scope, size)

    def atom(self, type_, scope):
        """Returns a literal, a variable, or what an element gives."""
        atoms = scope.of(type_)
        if atoms and not self.c.chance(30):
            return self.c.pick(atoms)
        entities = [text for text, of in scope.own if of == ENTITY]
        if entities and self.c.chance(60):
            this = self.c.pick(entities)
            if type_ == REAL:
                return f"{self.c.pick(REAL_RELATIONS)}({this})"
            if type_ == TEXT:
                return f"{self.c.pick(('id', 'type'))}({this})"
            if type_ == FLAG:
                return f"{self.c.pick(FLAG_RELATIONS)}({this})"
            if type_ == INT:
                return f"environmentID({this})"
        if type_.kind in LITERALS:
            return self.literal(type_)
        if type_.element is not None and type_.element.kind in LITERALS:
            return self.pair(type_.element, scope)
        return atoms[0] if atoms else "[[1, 2], [3, 4]]"

    def listed(self, type_, scope, size):
        """Returns a list of at least two elements."""
        element = type_.element
        if element is None or element.kind not in LITERALS:
            return self.atom(type_, scope)
        kind = self.c.below(6)
        parts = [self.expression(element, scope, size - 1, 9) for _ in range(2)]
        if kind == 0:
            return f"({self.atom(type_, scope)} + [{parts[0]}])"
        if kind == 1:
            condition = self.expression(FLAG, scope, size - 1, 9)
            return f"IF({condition}; {self.atom(type_, scope)}; {self.atom(type_, scope)})"
        if kind == 2 and element == REAL:
            entities = scope.of(ENTITY)
            if entities:
                return f"position({self.c.pick(entities)})"
        return f"[{', '.join(parts)}]"

    def choice(self, type_, scope, size, depth):
        """IF with branches of a type, perhaps one after another; of flags some may be missing."""
        condition = self.expression(FLAG, scope, size, depth)
        if type_ == FLAG and self.c.chance(20):
            return f"IF({condition})"
        then, other = (self.expression(type_, scope, size, depth) for _ in range(2))
        if self.c.chance(30):
            return f"CASE WHEN {condition} THEN {then} ELSE {other} END"
        if self.c.chance(20):
            one, two = (self.expression(TEXT, scope, 0, depth) for _ in range(2))
            return f"CASE {one} WHEN {two} THEN {then} ELSE {other} END"
        if type_ == FLAG and self.c.chance(20):
            return f"IF({condition}; {then})"
        if self.c.chance(20):
            further = self.expression(FLAG, scope, size, depth)
            other = f"IF({further}; {other}; {self.atom(type_, scope)})"
        return f"IF({condition}; {then}; {other})"

    def chain(self, type_, scope):
        """Returns about as many operands in a row as are kept flat."""
        signs = {"int": ("+", "-"), "real": ("+", "-", "*"), "text": ("+",)}
        parts = [self.atom(type_, scope) for _ in range(2)]
        many = self.c.pick((31, 32, 33, 40))
        if type_ == FLAG:
            return f" {self.c.pick(('OR', 'AND', 'XOR'))} ".join((parts * many)[:many])
        sign = self.c.pick(signs[type_.kind])
        return f" {sign} ".join((parts * many)[:many])

    def counted(self, scope, depth):
        """Returns a condition that counts where it holds, or how often it is asked."""
        condition = self.expression(FLAG, scope, 1, depth)
        if self.c.chance(50):
            return f"IF({condition}; tally = tally + 1, True; False)"
        return f"((tally = tally + 1) > {self.c.below(4)} AND {condition})"

    def divisor(self, type_, scope, size):
        """Returns a divisor that is not 0, unless errors are allowed."""
        if self.wild and self.c.chance(60):
            return self.expression(type_, scope, size, 9)
        if type_ == INT:
            return self.c.pick(("2", "3", "(-2)", "7"))
        return self.c.pick(("0.5", "2.0", "(-3.5)", "0.1"))

    def integer(self, scope, size, depth):
        one = self.expression(INT, scope, size, depth)
        match self.c.below(18):
            case 0 | 1 | 2 | 3:
                other = self.expression(INT, scope, size, depth)
                return f"{one} {self.c.pick(('+', '-', '*'))} {other}"
            case 4:
                divisor = self.divisor(INT, scope, size)
                return self.c.pick((f"{one} % {divisor}", f"mod({one}, {divisor})"))
            case 5:
                return f"{one} ^ {self.c.pick(('2', '0', '3', '1'))}"
            case 6:
                return self.c.pick((f"-{one}", f"neg({one})", f"sub(1, {one})", f"mul(2, {one})"))
            case 7:
                return f"abs({one})"
            case 8:
                real = self.expression(REAL, scope, size, depth)
                return f"{self.c.pick(('floor', 'ceil', 'round'))}({real})"
            case 9:
                return f"plain({one}, {self.atom(INT, scope)})"
            case 10:
                return f"{self.c.pick(('bare', 'unhinted'))}({one})"
            case 11:
                return self.choice(INT, scope, size, depth)
            case 12:
                values = self.expression(INTS, scope, size, depth)
                return f"{self.c.pick(('sum', 'min', 'max', 'count'))}({values})"
            case 13:
                return self.indexed(INT, scope, size)
            case 14:
                return f"past{{{one if self.wild else f'abs({one})'}}}"
        if depth > self.deepest:
            return one
        return self.of_query(INT, scope, depth)

    def of_query(self, type_, scope, depth):
        kind = self.c.below(3)
        if type_ in (INT, REAL) and kind < 2:
            query = self.nested(self.query(scope, depth, type_, "list"))
            if type_ == INT and kind == 0:
                return f"count({query})"
            names = ("sum", "min", "max") if self.wild else ("sum",)
            return f"{self.c.pick(names)}({query})"
        if self.wild or self.c.chance(30):
            return self.nested(self.query(scope, depth, type_, "value"))
        # A value that is there.
        source = Source(self.alias(), "ints", INT)
        inner = self.inside(scope, [source])
        column = self.expression(type_, inner, 1, 9)
        order = " ".join(self.arranging(inner, [source])).split("LIMIT")[0].strip()
        return f"(SELECT {column} FROM {source.written} {order} AS value)"

    def indexed(self, type_, scope, size):
        values = self.expression(list_of(type_), scope, size, 9)
        if self.wild and self.c.chance(50):
            return f"{values}[{self.expression(INT, scope, size, 9)}]"
        return f"{values}[{self.c.pick(('0', '1', '-1', '-2'))}]"

    def real(self, scope, size, depth):
        one = self.expression(REAL, scope, size, depth)
        match self.c.below(17):
            case 0 | 1 | 2:
                type_ = self.c.pick((REAL, INT))
                other = self.expression(type_, scope, size, depth)
                return f"{one} {self.c.pick(('+', '-', '*'))} {other}"
            case 3 | 4:
                type_ = self.c.pick((REAL, INT))
                return f"{self.expression(type_, scope, size, depth)} / {self.divisor(REAL, scope, size)}"
            case 5:
                return f"{one} % {self.divisor(self.c.pick((REAL, INT)), scope, size)}"
            case 6:
                return f"{one} ^ {self.c.pick(('2', '0', '3', '1'))}"
            case 7:
                return f"-{one}"
            case 8:
                return f"abs({one})" if self.c.chance(50) else f"sqrt(abs({one}))"
            case 9:
                return f"scaled({one})"
            case 10:
                return f"{self.c.pick(('bare', 'unhinted'))}({one})"
            case 11:
                return self.choice(REAL, scope, size, depth)
            case 12:
                values = self.expression(REALS, scope, size, depth)
                return f"{self.c.pick(('sum', 'min', 'max', 'avg'))}({values})"
            case 13:
                return self.indexed(REAL, scope, size)
            case 14:
                entities = scope.of(ENTITY)
                if entities:
                    return f"distance({self.c.pick(entities)}, {self.c.pick(entities)})"
                return f"round({one}, {self.c.below(3)})"
        return one if depth > self.deepest else self.of_query(REAL, scope, depth)

    def text(self, scope, size, depth):
        one = self.expression(TEXT, scope, size, depth)
        match self.c.below(9):
            case 0 | 1:
                return f"{one} + {self.expression(TEXT, scope, size, depth)}"
            case 2 | 3:
                return f"str({self.expression(self.c.pick(SCALARS), scope, size, depth)})"
            case 4:
                return self.choice(TEXT, scope, size, depth)
            case 5:
                return f"{self.c.pick(('bare', 'unhinted'))}({one})"
            case 6:
                return self.indexed(TEXT, scope, size)
            case 7:
                return f"trail{{1 + abs({self.expression(INT, scope, size, depth)})}}"
        return one if depth > self.deepest else self.of_query(TEXT, scope, depth)

    def flag(self, scope, size, depth):
        entities = scope.of(ENTITY)
        kind = self.c.below(25)
        if kind >= 22:
            return self.habit(scope, size, kind)
        if kind < 6 or (kind in (20, 21) and not entities):
            return self.comparison(scope, size, depth)
        if kind < 9:
            left, right = (self.expression(FLAG, scope, size, depth) for _ in range(2))
            signs = ("OR", "XOR", "AND") if self.joins else ("OR", "XOR")
            return f"{left} {self.c.pick(signs)} {right}"
        if kind == 9:
            return f"NOT {self.expression(FLAG, scope, size, depth)}"
        if kind < 12:
            return self.membership(scope, size, depth)
        if kind == 12:
            return self.choice(FLAG, scope, size, depth)
        if kind == 13:
            left, right = (self.expression(TEXT, scope, size, 9) for _ in range(2))
            return f"longer({left}, {right})"
        if kind == 14:
            return f"bare({self.expression(FLAG, scope, size, depth)})"
        if kind < 20:
            return self.of_rows(scope, size, depth)
        names = (self.c.pick(entities), self.c.pick((*entities, "box")))
        return f"{self.c.pick(PAIR_RELATIONS)}({names[0]}, {names[1]})"

    def habit(self, scope, size, kind):
        """Returns a condition as SQL has it."""
        negated = self.c.pick(("", "NOT "))
        if kind == 22:
            one = self.expression(TEXT, scope, size, 9)
            pattern = self.c.pick(("'%'", "'a%'", "'_'", "'%b%'", "'a_'", "''", "'box'"))
            return f"{one} {negated}LIKE {pattern}"
        type_ = self.c.pick((INT, REAL))
        one = self.expression(type_, scope, size, 9)
        if kind == 23:
            low, high = (self.expression(type_, scope, 0, 9) for _ in range(2))
            return f"({one} {negated}BETWEEN {low} AND {high})"
        if self.c.chance(40):
            return f"{one} IS {negated}NULL"
        values = ", ".join(self.literal(type_) for _ in range(self.c.below(4)))
        return f"{one} {negated}IN ({values})"

    def comparison(self, scope, size, depth):
        type_ = self.c.pick((INT, REAL, TEXT, INTS, FLAG, ENTITY))
        if type_ == ENTITY:
            entities = scope.of(ENTITY)
            if entities:
                return f"{self.c.pick(entities)} {self.c.pick(('==', '!='))} box"
            type_ = INT
        other = self.c.pick((INT, REAL)) if type_ in (INT, REAL) else type_
        if self.c.chance(4):
            other = self.c.pick(SCALARS)
        left = self.expression(type_, scope, size, depth)
        right = self.expression(other, scope, size, depth)
        both = {type_, other}
        ordered = both <= {INT, REAL} or both == {TEXT}
        signs = COMPARISONS if ordered or (self.wild and self.c.chance(30)) else ("==", "!=")
        return f"{left} {self.c.pick(signs)} {right}"

    def membership(self, scope, size, depth):
        """IN a list, a text, a query."""
        type_ = self.c.pick((INT, TEXT, REAL))
        left = self.expression(type_, scope, size, depth)
        if type_ == TEXT and self.c.chance(40):
            return f"{left} IN {self.expression(TEXT, scope, size, depth)}"
        if depth <= self.deepest and self.c.chance(50):
            return f"{left} IN {self.nested(self.query(scope, depth, type_, 'list'))}"
        if self.c.chance(15):
            type_ = self.c.pick((INT, TEXT, REAL))
        return f"{left} IN {self.expression(list_of(type_), scope, size, depth)}"

    def of_rows(self, scope, size, depth):
        if depth > self.deepest:
            return self.comparison(scope, size, depth)
        type_ = self.c.pick((INT, TEXT, REAL))
        form = self.c.pick(("list", "list", "dict", "value"))
        query = self.nested(self.query(scope, depth, type_, form))
        kind = self.c.below(4)
        if kind < 2:
            sides = ("[]", query) if self.c.chance(50) else (query, "[]")
            return f"{sides[0]} {self.c.pick(('==', '!='))} {sides[1]}"
        query = self.nested(self.query(scope, depth, type_, "list"))
        if kind == 2:
            sign = self.c.pick(COMPARISONS)
            return f"count({query}) {sign} {self.c.pick(('1', '0', '2', 'n'))}"
        return f"{self.pair(type_, scope)} == {query}"


def program(choices):
    return Grammar(choices).program()
