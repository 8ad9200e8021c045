"""The command line's arguments into dataclasses; what is wrong with them in one line."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import io
import itertools
import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import tyro

from baselines.usage import UsageError

PROGRAM = "bnprl"
ESCAPES = re.compile(r"\x1b\[[0-9;]*m")


def parse(commands: Mapping[str, type[Any]], description: str, given: Sequence[str]) -> Any:
    """Return the dataclass of the command that is named first, filled from its arguments.

    Args:
        commands: name -> dataclass whose fields are the arguments, in tyro's annotations.
        description: shown by `--help`, which prints and exits.
        given: the arguments.

    Raises:
        UsageError: they are no such arguments; near misses of a command or an option are named.
    """
    name = given[0] if given else ""
    if not name:
        raise UsageError(f"a command is missing: {', '.join(commands)}")
    if not name.startswith("-") and name not in commands:
        raise UsageError(f"unknown command {name!r}; {_near(name, list(commands))}")
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            return tyro.extras.subcommand_cli_from_dict(
                dict(commands), prog=PROGRAM, description=description, args=given
            )
    except SystemExit as end:
        if not end.code:
            raise
        fields = dataclasses.fields(commands[name]) if name in commands else ()
        raise UsageError(_reason(name, fields, given, box.getvalue())) from None


def _near(wrong: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(wrong, known, n=3)
    return f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(known)}"


def _reason(
    command: str, fields: Sequence[dataclasses.Field[Any]], given: Sequence[str], box: str
) -> str:
    """Return in one line what tyro says in a box."""
    flags = ["--help", *flags_of(fields)]
    for token in given:
        flag = token.partition("=")[0].replace("_", "-")
        if flag.startswith("--") and flag not in flags:
            return f"{command}: unknown option {flag}; {_near(flag, flags)}".lstrip(": ")
    rows = _message(box)
    text = " ".join(" ".join(rows).split()).rstrip(".")
    missing = [row.split()[0] for row in rows if re.match(r" {4}\S", row)]
    if "Missing from" in text and missing:
        return f"{command}: missing {', '.join(missing)}; see {PROGRAM} {command} --help"
    value = re.match(r"Error parsing (\S+): (.*)'([^']*)'", text)
    if value:
        kind = "whole number" if re.search(r"INT|int\(\)", value[2]) else "number"
        return f"{value[1]}: {value[3]!r} is no {kind}"
    return f"{command}: {text[:1].lower()}{text[1:]}"


def _message(box: str) -> list[str]:
    """Return the rows of a box between its title and the rule that parts them from the help."""
    _, *rows = ESCAPES.sub("", box).splitlines()
    bare = [row.strip("│") for row in rows]
    rest = itertools.dropwhile(_is_rule, bare)  # without UTF-8 the title has a rule of its own
    message = itertools.takewhile(lambda row: not _is_rule(row), rest)
    return textwrap.dedent("\n".join(message)).splitlines()


def _is_rule(row: str) -> bool:
    return set(row.strip()) <= set("─-╰╯")


def flags_of(fields: Sequence[dataclasses.Field[Any]]) -> list[str]:
    """Return the options of a dataclass, those of settings within it included."""
    flags = []
    for field in fields:
        flag = f"--{field.name.replace('_', '-')}"
        if field.default_factory is not dataclasses.MISSING and dataclasses.is_dataclass(
            settings := field.default_factory()
        ):
            flags += flags_of(dataclasses.fields(settings))
        elif isinstance(field.default, bool):
            flags += [flag, flag.replace("--", "--no-", 1)]
        elif "Positional" not in str(field.type):
            flags.append(flag)
    return flags
