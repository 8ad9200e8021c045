"""The `bnprl` command. Nothing heavy is imported before a command needs it."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import logging
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import tyro

from baselines import options
from baselines.arguments import flags_of, parse
from baselines.usage import UsageError, usage_errors

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMBA_NUM_THREADS",
)
"""One thread each: runs are what is done in parallel, and sums are always taken in one order."""

DESCRIPTION = (
    "Reinforcement learning with nonparametric policies: train, evaluate and compare agents. "
    "Each command has --help; --version shows the version."
)


COMMANDS: dict[str, tuple[type[Any], str]] = {
    "list": (options.ListNames, "commands:list_names"),
    "train": (options.Train, "commands:train"),
    "evaluate": (options.Evaluate, "evaluate:evaluate_policies"),
    "compare": (options.Compare, "commands:compare"),
    "reproduce": (options.Reproduce, "reproduce:reproduce"),
    "report": (options.Report, "commands:report"),
    "aggregate": (options.Aggregate, "aggregate:aggregate"),
    "status": (options.Status, "status:status"),
    "plot": (options.Plot, "plot:plot"),
    "bounds": (options.Bounds, "bounds:print_bounds"),
    "watch": (options.Watch, "watch:watch"),
}
"""Name -> what it takes, and "module:function" of what it does, imported when it is wanted."""
BROKEN_PIPE = 141
"""Exit code of a command whose output nobody reads to the end, as shells count signals."""
RECORDING = (options.Train, options.Compare, options.Reproduce)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if "numpy" not in sys.modules:  # later it would be in vain
        for variable in THREAD_VARIABLES:
            os.environ.setdefault(variable, "1")
    logging.basicConfig(format="bnprl: warning: %(message)s", level=logging.WARNING)
    try:
        if given[:1] == ["--version"]:
            return _version()
        with _terminable(), _flushed():
            return _run(_parse(given), given)
    except BrokenPipeError:  # whoever was reading has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except UsageError as error:
        print(f"bnprl: error: {error}", file=sys.stderr)
        return 2
    except MemoryError as error:
        print(f"bnprl: error: not enough memory: {error or given[0]}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as end:
        kept = COMMANDS[given[0]][0] in RECORDING if given and given[0] in COMMANDS else False
        print(f"bnprl: interrupted{'; the same command resumes' * kept}", file=sys.stderr)
        return end.args[0] if end.args else 128 + signal.SIGINT


@contextlib.contextmanager
def _flushed() -> Iterator[None]:
    """Write out what was printed, so that a pipe that has closed is noticed here."""
    try:
        yield
    finally:
        sys.stdout.flush()


@contextlib.contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM, by which schedulers end a job, do what an interrupt does."""

    def stop(number: int, _: Any) -> None:
        raise KeyboardInterrupt(128 + number)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _version() -> int:
    import importlib.metadata

    try:
        print(f"bnprl {importlib.metadata.version('bnprl')}")
    except importlib.metadata.PackageNotFoundError:
        print("bnprl (not installed)")
    return 0


def _parse(given: list[str]) -> Any:
    commands = {name: taken for name, (taken, _) in COMMANDS.items()}
    if given[:1] == ["train"]:
        commands["train"] = _train_with_settings(given)
    return parse(commands, DESCRIPTION, given)


def _train_with_settings(given: list[str]) -> type[options.Train]:
    """Return `Train` with the settings of the agent that the arguments name."""
    flags = [*given, ""]
    names = [flags[i + 1] for i, flag in enumerate(given) if flag == "--agent"]
    names += [flag.removeprefix("--agent=") for flag in given if flag.startswith("--agent=")]
    if not names or not names[0]:
        return options.Train
    from baselines.contenders import contender

    with usage_errors():
        settings = contender(names[0]).settings
        _check_flags(names[0], settings)
    if not dataclasses.fields(settings):
        return options.Train
    lenient = dataclasses.make_dataclass(  # values are checked later, to be refused in one line
        type(settings).__name__,
        [],
        bases=(type(settings),),
        frozen=type(settings).__dataclass_params__.frozen,
        namespace={"__post_init__": lambda _: None},
    )
    lenient.__doc__ = type(settings).__doc__
    default = dataclasses.field(default_factory=lambda: lenient(**vars(settings)))
    kind = Annotated[lenient, tyro.conf.OmitArgPrefixes]  # type: ignore[valid-type]
    made = dataclasses.make_dataclass(
        "Train", [("settings", kind, default)], bases=(options.Train,), frozen=True
    )
    made.__doc__ = options.Train.__doc__
    return made


def _check_flags(agent: str, settings: Any) -> None:
    """Refuse settings whose flags are those of `train` itself (ValueError)."""
    taken = set(flags_of(dataclasses.fields(options.Train)))
    for field in dataclasses.fields(settings):
        if taken.intersection(flags_of([field])):
            raise ValueError(
                f"{agent}: its setting {field.name} has the name of an option of train; rename it, "
                "or set it with compare --set"
            )


def _run(chosen: Any, given: list[str]) -> int:
    """Do the command that the options are of; what writes records keeps how it was given."""
    target = next(do for taken, do in COMMANDS.values() if isinstance(chosen, taken))
    module, name = target.split(":")
    do = getattr(importlib.import_module(f"baselines.{module}"), name)
    done: int = do(chosen, given) if isinstance(chosen, RECORDING) else do(chosen)
    return done


if __name__ == "__main__":
    sys.exit(main())
