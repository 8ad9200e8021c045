"""What the commands of `bnprl` take: one dataclass each, whose docstrings are the help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

Environment = Annotated[str, arg(metavar="ID")]
Progress = Annotated[bool, arg(name="progress")]


@dataclass(frozen=True)
class ListNames:
    """List what there is: environments, agents or ready-made experiments."""

    what: Positional[Literal["envs", "agents", "experiments"]]
    """What to list."""


@dataclass(frozen=True)
class Train:
    """Train one agent in one environment.

    The agent's settings are flags too: `bnprl train ID --agent NAME --help` shows them.
    """

    id: Positional[Environment]
    """Environment id, or path of a .POMDP or .dpomdp file."""
    agent: str
    """Agent; `bnprl list agents` names them, MODULE:CLASS is one of your own."""
    out: Path
    """Folder for the records, the policy and the report."""
    episodes: int | None = None
    """Training episodes; give this or --steps."""
    steps: int | None = None
    """Environment steps of training; give this or --episodes."""
    seed: int = 0
    """Everything random is derived from it."""
    eval_episodes: int = 1000
    """Episodes of each evaluation."""
    eval_points: int = 10
    """Evaluations, evenly spread over the budget."""
    tensorboard: bool = False
    """Write evaluations and what learners report for TensorBoard, below the folder."""
    progress: Progress = True
    """Show a progress bar."""


@dataclass(frozen=True)
class Evaluate:
    """Evaluate learned policies; the exact value too, where the model is known."""

    target: Positional[Path]
    """Folder that `train` or `compare` wrote, or a policy file."""
    episodes: int = 1000
    """Episodes for each policy."""
    env: str | None = None
    """Environment id or model file, for a policy file outside such a folder."""
    agent: str | None = None
    """MODULE:CLASS of the policies, where that is an agent of your own."""
    seed: int = 0
    """Everything random is derived from it."""
    progress: Progress = True
    """Show a progress bar."""


@dataclass(frozen=True)
class Compare:
    """Compare agents head to head: equal budgets, several seeds, intervals, one report.

    A command that was interrupted goes on when it is given again; agents and seeds can be added.
    """

    id: Positional[Environment]
    """Environment id, or path of a .POMDP or .dpomdp file."""
    agents: tuple[str, ...]
    """Agents; `bnprl list agents` names them, MODULE:CLASS is one of your own."""
    out: Path
    """Folder for the records, the policies and the report."""
    episodes: int | None = None
    """Training episodes of each run; give this or --steps."""
    steps: int | None = None
    """Environment steps of each run; give this or --episodes."""
    seeds: int = 5
    """Runs of each agent."""
    seed: int = 0
    """Root from which the seeds of all runs are derived."""
    set: tuple[str, ...] = ()
    """Settings that differ from the defaults, as AGENT.FIELD=VALUE: online-em.reward_shift=10."""
    jobs: int | None = None
    """Runs at the same time; as many as cores if not given."""
    eval_episodes: int = 1000
    """Episodes of each evaluation."""
    eval_points: int = 10
    """Evaluations of each run, evenly spread over the budget."""
    engine: Literal["joblib", "ray", "dask"] = "joblib"
    """What spreads the runs: processes here, or a cluster of Ray or Dask."""
    address: str | None = None
    """Of a cluster that is there already and sees the same files; one is started if not given."""
    tensorboard: bool = False
    """Write evaluations and what learners report for TensorBoard, below the folder."""
    progress: Progress = True
    """Show a progress bar."""


@dataclass(frozen=True)
class Reproduce:
    """Reproduce a table or figure of the source; `bnprl list experiments` names them.

    A command that was interrupted goes on when it is given again.
    """

    name: Positional[str | None] = None
    """Experiment; or give --all."""
    all: bool = False
    """Every experiment, one after the other, and one page about all of them."""
    quick: bool = False
    """Few seeds and steps: two minutes on two cores for each experiment."""
    out: Path | None = None
    """Folder for the records, the figure, the tables and the page; below results/ if not given."""
    jobs: int | None = None
    """Runs at the same time; as many as cores if not given."""
    engine: Literal["joblib", "ray", "dask"] = "joblib"
    """What spreads the runs: processes here, or a cluster of Ray or Dask."""
    address: str | None = None
    """Of a cluster that is there already and sees the same files; one is started if not given."""
    progress: Progress = True
    """Show a progress bar."""


@dataclass(frozen=True)
class Report:
    """Make the tables, the curves or figure, and the page again from the records."""

    folder: Positional[Path]
    """Folder that `train`, `compare` or `reproduce` wrote."""


@dataclass(frozen=True)
class Aggregate:
    """Join comparisons of several environments: normalised scores, profiles, who beats whom."""

    folders: Positional[tuple[Path, ...]]
    """Folders that `compare` or `reproduce` wrote, one environment each."""
    out: Path
    """Folder for the tables and the picture."""


@dataclass(frozen=True)
class Status:
    """Show which runs are done, running, failed or still to come, and how long they will take."""

    folder: Positional[Path]
    """Folder that `train`, `compare` or `reproduce` wrote or is writing."""


@dataclass(frozen=True)
class Plot:
    """Draw what a policy file holds: action values over the plane of the states, or controllers.

    Controllers become graphs: nodes sized by occupancy and coloured by action, arrows coloured by
    observation, weak ones hidden; below, nodes and exploration over learning.
    """

    file: Positional[Path]
    """Policy file, below runs/ in a folder that `train`, `compare` or `reproduce` wrote."""
    out: Path | None = None
    """Picture (PNG); beside the policy file if not given."""
    env: str | None = None
    """Environment id, for a policy file outside such a folder."""
    agent: str | None = None
    """MODULE:CLASS of the policy, where that is an agent of your own."""


@dataclass(frozen=True)
class Bounds:
    """Compute how good an answer can be: simple policies, upper and lower bounds of the optimum."""

    id: Positional[Environment]
    """Environment id, or path of a .POMDP or .dpomdp file."""
    seconds: float = 10.0
    """Time for each search: the point-based bound and each kind of memoryless policy."""
    discount: float | None = None
    """Factor of the returns, below 1; the model's own if not given."""
    seed: int = 0
    """Everything random is derived from it."""
    progress: Progress = True
    """Show a progress bar."""


@dataclass(frozen=True)
class Watch:
    """Look at episodes: as text here, as a GIF, or in a window.

    Beside the picture: the discounted return so far, and where a finite-state controller is.
    """

    id: Positional[Environment]
    """Environment id, or path of a .POMDP or .dpomdp file."""
    policy: Path | None = None
    """Policy file that `train` or `compare` wrote; uniformly random actions if not given."""
    agent: str | None = None
    """MODULE:CLASS of the policy, where that is an agent of your own."""
    gif: Path | None = None
    """Write this animation instead of printing text."""
    human: bool = False
    """Show a window instead of printing text."""
    belief: bool = False
    """Show how likely each state is, given all that was seen so far (one agent, known model)."""
    episodes: int = 1
    """Episodes to watch."""
    steps: int | None = None
    """Steps of an episode to watch, at most; all if not given."""
    seed: int = 0
    """Everything random is derived from it."""
    progress: Progress = True
    """Show a progress bar while a GIF is made."""
