"""What the user's own modules hold: found by name, imported only when a command line names it."""

from __future__ import annotations

import dataclasses
import importlib
import os
import sys
from types import ModuleType
from typing import Any


def is_own(name: str) -> bool:
    """Return whether a name is of the form "module:name"."""
    return ":" in name


def import_module(name: str, of: str) -> ModuleType:
    """Import a module, from the working folder too.

    Args:
        name: of the module.
        of: what wants it, for the message.

    Raises:
        ValueError: it cannot be imported.
    """
    here = os.getcwd()
    if here not in sys.path:
        sys.path.append(here)  # at the end, where it hides no package
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ValueError(f"{of}: cannot import {name} ({error})") from error


def agent_class(name: str) -> Any:
    """Return the agent of "module:class".

    Raises:
        ValueError: there is none, or it is no whole subclass of `bnprl_agents.Agent`, or its
            `Config` is no dataclass with defaults.
    """
    from bnprl_agents.agent import Agent

    module, _, attribute = name.partition(":")
    found = getattr(import_module(module, name), attribute, None)
    if found is None:
        raise ValueError(f"{name}: {module} has no {attribute}")
    if not (isinstance(found, type) and issubclass(found, Agent)):
        raise ValueError(f"{name}: {attribute} is no subclass of bnprl_agents.Agent")
    if missing := sorted(getattr(found, "__abstractmethods__", ())):
        raise ValueError(f"{name}: {attribute} lacks {', '.join(missing)}")
    _check_config(name, getattr(found, "Config", None))
    return found


def _check_config(name: str, config: Any) -> None:
    if not (isinstance(config, type) and dataclasses.is_dataclass(config)):
        raise ValueError(f"{name}: its Config must be a dataclass")
    for field in dataclasses.fields(config):
        if field.init and field.default is field.default_factory is dataclasses.MISSING:
            raise ValueError(f"{name}: its Config needs a default of {field.name}")
