"""What the functions in one C file share: names, tables, structs and the few functions C lacks."""

import itertools
import re
from collections.abc import Container, Iterable
from typing import Any, NamedTuple

from zswarm.robots.c.c_types import SCALARS, Scalar, StructType, literal, spelled
from zswarm.robots.c.tree import INDENT

PER_LINE = 6  # numbers of a table
MATH = {"NAN", "INFINITY", "fabs", "fabsf", "fmod", "sqrt", "sqrtf"}  # of math.h

# For Python's operations that have no operator in C, or one whose result C leaves open.
LIBRARY = {
    "floor_divide": """static int64_t {name}(int64_t a, int64_t b)
{{
    int64_t quotient = 0;
    if (b != 0) {{
        quotient = a / b;
        if (((a % b) != 0) && ((a < 0) != (b < 0))) {{
            quotient = quotient - 1;
        }}
    }}
    return quotient;
}}
""",
    "floor_rest": """static int64_t {name}(int64_t a, int64_t b)
{{
    int64_t rest = 0;
    if (b != 0) {{
        rest = a % b;
        if ((rest != 0) && ((rest < 0) != (b < 0))) {{
            rest = rest + b;
        }}
    }}
    return rest;
}}
""",
    "rest": """static double {name}(double a, double b)
{{
    double rest = fmod(a, b);
    if ((rest != 0.0) && ((rest < 0.0) != (b < 0.0))) {{
        rest = rest + b;
    }}
    return rest;
}}
""",
}
BITS = """static %s {name}(%s)
{{
    union {{
        uint64_t bits;
        double number;
    }} both;
    both.%s;
    return both.%s;
}}
"""
LIBRARY["double_of_bits"] = BITS % ("double", "uint64_t bits", "bits = bits", "number")
LIBRARY["bits_of_double"] = BITS % (
    "uint64_t",
    "double number",
    "number = number",
    "bits",
)


class CSource(NamedTuple):
    """C of some functions.

    Attributes:
        includes: lines that both others need.
        declarations: prototypes of public functions, and the structs that they return.
        definitions: everything else.
    """

    includes: str
    declarations: str
    definitions: str


class CFile:
    """A C file that grows; texts are in the order in which C must know them.

    Attributes:
        prefix: of all names, an identifier of C.
    """

    def __init__(self, prefix: str) -> None:
        self.prefix = prefix
        self._names: set[str] = set()
        self._prototypes: list[str] = []
        self._bodies: list[str] = []
        self._structs: dict[str, str] = {}
        self._library: dict[str, str] = {}
        # Values: name, text.
        self._tables: dict[tuple[str, bytes, str], tuple[str, str]] = {}

    def name(self, wanted: str) -> str:
        """Reserve a name in this file."""
        name = free(f"{self.prefix}_{wanted}", self._names)
        self._names.add(name)
        return name

    def library(self, which: str) -> str:
        """Return the name of a function of ``LIBRARY``, and add that function."""
        if which not in self._library:
            self._library[which] = self.name(which)
        return self._library[which]

    def table(self, hint: str, numbers: Any) -> str:
        """Add a table of constants, and return its name."""
        key = (numbers.dtype.name, numbers.tobytes(), hint)
        if key not in self._tables:
            name, of = self.name(spelled(hint)), SCALARS[numbers.dtype.name].c
            texts = [literal(number) for number in numbers]
            rows = [
                ", ".join(texts[at : at + PER_LINE])
                for at in range(0, len(texts), PER_LINE)
            ]
            body = f",\n{INDENT}".join(rows)
            text = f"static const {of} {name}[{len(numbers)}] = {{\n{INDENT}{body}\n}};\n"
            self._tables[key] = name, text
        return self._tables[key][0]

    def struct(
        self, function: str, of: tuple[Scalar, ...], names: tuple[str, ...]
    ) -> StructType:
        """Add a struct for the tuple that a function returns."""
        name = self.name(f"{spelled(function)}_result")
        members = zip(of, names, strict=True)
        text = "".join(f"{INDENT}{each.c} {member};\n" for each, member in members)
        self._structs[name] = f"typedef struct {{\n{text}}} {name};\n"
        return StructType(name, of, names)

    def add(self, head: str, remark: str, text: str, *, public: bool) -> None:
        """Add a function with its declaration, a comment or "", and its body."""
        if public:
            self._prototypes.append(f"{remark}{head};\n")
        self._bodies.append(
            f"{remark}{'' if public else 'static '}{head}\n{{\n{text}\n}}\n"
        )

    def source(self) -> CSource:
        """Return the text; tables that no function names are left out."""
        library = [
            LIBRARY[which].format(name=name) for which, name in self._library.items()
        ]
        bodies = [*library, *self._bodies]
        used = _words(bodies)
        tables = [text for name, text in self._tables.values() if name in used]
        headers = ["float", "math", "stdbool", "stdint"]
        if not _words([*tables, *bodies]) & MATH:
            headers.remove("math")
        results = _words(self._prototypes)
        # By whether others need them.
        structs: dict[bool, list[str]] = {True: [], False: []}
        for name, text in self._structs.items():
            structs[name in results].append(text)
        return CSource(
            "".join(f"#include <{header}.h>\n" for header in headers),
            "\n".join([*structs[True], *self._prototypes]),
            "\n".join([*structs[False], *tables, *bodies]),
        )


def free(wanted: str, taken: Container[str]) -> str:
    """Return a name that is not taken: the wanted one, else with a number."""
    numbered = (f"{wanted}_{number}" for number in itertools.count(2))
    return next(name for name in itertools.chain([wanted], numbered) if name not in taken)


def _words(texts: Iterable[str]) -> set[str]:
    return set(re.findall(r"\w+", "\n".join(texts)))
