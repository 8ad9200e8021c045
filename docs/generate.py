"""One page per environment: its docstring, what the registry knows, and two episodes played now.

`python docs/generate.py` writes them to docs/environments; building the documentation does, too.
Nothing on those pages is typed by hand.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pettingzoo
from PIL import Image

import bnprl_envs
from baselines.report import REFERENCE_NAMES, markdown_table
from bnprl_envs import hand_coded
from bnprl_envs.model import TabularModel
from bnprl_envs.planning import belief_update, q_mdp
from bnprl_envs.point_based import point_based_lower_bound
from bnprl_envs.registration import Entry

PLANNING_SECONDS = 1.0
"""Time for the point-based policy that plays a good episode."""
FRAMES = 16
"""Frames of a picture, at most."""
FRAME_MILLISECONDS = 400
FORMS = {
    "tabular": "Gymnasium, tabular",
    "class": "Gymnasium, continuous state",
    "parallel-tabular": "PettingZoo (parallel), tabular",
    "parallel-class": "PettingZoo (parallel), simulated",
}

Act = Callable[[int, Sequence[Any]], Sequence[int]]
"""Actions of all agents, from the number of steps done and what each agent has just seen."""


class Episode(NamedTuple):
    """What an episode earned, how long it took, and what its beginning looked like."""

    value: float
    steps: int
    frames: list[Image.Image]


def write_pages(folder: Path) -> None:
    """Write the pages, their pictures, and the page that lists them."""
    folder.mkdir(exist_ok=True)
    entries = [bnprl_envs.entry(id) for id in bnprl_envs.environment_ids()]
    for entry in entries:
        words, policy = good_policy(entry)
        good, random = play(entry, policy), play(entry, random_policy(entry))
        save_picture(good, folder / f"{name(entry)}-good.gif")
        save_picture(random, folder / f"{name(entry)}-random.gif")
        text = page(entry, words, good, random)
        (folder / f"{name(entry)}.md").write_text(text, encoding="utf-8")
    (folder / "index.md").write_text(listing(entries), encoding="utf-8")


def save_picture(episode: Episode, path: Path) -> None:
    """Write the frames of an episode as an animation."""
    first, *rest = (frame.quantize(64) for frame in episode.frames)
    first.save(path, save_all=True, append_images=rest, duration=FRAME_MILLISECONDS, loop=0)


def name(entry: Entry) -> str:
    """Return the id without namespace and version."""
    return entry.id.removeprefix("bnprl/").rsplit("-v", 1)[0]


# --- what is played ---------------------------------------------------------------------------


def play(entry: Entry, act: Act) -> Episode:
    """Play one episode and draw its first steps."""
    parallel = entry.kind.startswith("parallel")
    env: Any = (
        pettingzoo.make("parallel", entry.id, render_mode="rgb_array")
        if parallel
        else gym.make(entry.id, render_mode="rgb_array")
    )
    seen, _ = env.reset(seed=0)
    value, step, over, frames = 0.0, 0, False, []
    while True:
        actions = act(step, list(seen.values()) if parallel else [seen])
        if step < FRAMES:
            env.unwrapped.belief = getattr(act, "belief", None)
            frames.append(Image.fromarray(env.render()))
        if over:
            break
        if parallel:
            seen, rewards, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
            reward, over = rewards["agent_0"], not env.agents
        else:
            seen, reward, terminated, truncated, _ = env.step(actions[0])
            over = terminated or truncated
        value += entry.discount**step * reward
        step += 1
    env.close()
    return Episode(value, step, frames)


def random_policy(entry: Entry) -> Act:
    """Return uniformly random actions."""
    rng, sizes = np.random.default_rng(1), action_sizes(entry)  # not the environment's numbers
    return lambda step, seen: rng.integers(sizes).tolist()


def good_policy(entry: Entry) -> tuple[str, Act]:
    """Return what plays well, in words, and the policy itself."""
    if entry.id in hand_coded.POLICIES:
        words, policy = list(hand_coded.POLICIES[entry.id].items())[-1]
        return f"written by hand: {words}", by_hand(entry, policy)
    listed = next((r.policy for r in entry.references if r.policy), None)
    if listed is not None:
        return "the best known deterministic memoryless policy", lambda step, seen: [
            actions[own] for actions, own in zip(listed, seen, strict=True)
        ]
    model = bnprl_envs.model(entry.id)
    if model.fully_observed:
        best = q_mdp(model).argmax(axis=0).tolist()
        return "optimal", lambda step, seen: [best[seen[0]]]
    return f"point-based, planned for {PLANNING_SECONDS:g} s", BeliefPolicy(model)


def by_hand(entry: Entry, policy: hand_coded.Policy) -> Act:
    """Return a policy for batches as one for a single copy."""
    rng = np.random.default_rng(0)

    def act(step: int, seen: Sequence[Any]) -> Sequence[int]:
        batch = np.array([seen if entry.kind == "parallel-class" else seen[0]])
        return np.atleast_1d(policy(batch, step, rng)[0]).tolist()

    return act


class BeliefPolicy:
    """Acts by point-based vectors on the belief that it keeps."""

    def __init__(self, model: TabularModel) -> None:
        self.model = model
        self.policy = point_based_lower_bound(model, seconds=PLANNING_SECONDS)
        self.belief, self.action = model.start, 0

    def __call__(self, step: int, seen: Sequence[int]) -> Sequence[int]:
        """Update the belief by what was seen, and return the action."""
        if step:
            self.belief, _ = belief_update(self.model, self.belief, self.action, seen[0])
        self.action = self.policy.act(self.belief)
        return [self.action]


def action_sizes(entry: Entry) -> list[int]:
    """Return the number of actions of each agent."""
    if "tabular" in entry.kind:
        return list(bnprl_envs.model(entry.id).action_sizes)
    space = hand_coded.make_batch(entry.id, 1).single_action_space
    return space.nvec.tolist() if hasattr(space, "nvec") else [int(space.n)]


# --- what is written --------------------------------------------------------------------------


def page(entry: Entry, words: str, good: Episode, random: Episode) -> str:
    """Return the page of an environment as Markdown."""
    return f"""# {name(entry)}

{entry.summary[0].upper()}{entry.summary[1:]}.

![the beginning of a good episode of {name(entry)}]({name(entry)}-good.gif)

{facts(entry)}

```python
{usage(entry)}
```

{description(entry)}

## Values

Expected discounted returns from the start. `bnprl bounds {entry.id}` computes again what can be
computed, and `bnprl compare {entry.id}` shows them beside the learners.

{values(entry)}

## Episodes

The good policy, shown above, is {words}: it earned {good.value:.4g} in {good.steps} steps.
Uniformly random actions earned {random.value:.4g} in {random.steps}:

![the beginning of a random episode of {name(entry)}]({name(entry)}-random.gif)
"""


def facts(entry: Entry) -> str:
    """Return the table of what the registry and the model say."""
    rows = [
        ("form", FORMS[entry.kind]),
        ("id", f"`{entry.id}`"),
        ("truncated after", f"{entry.horizon} steps"),
        ("discount", f"{entry.discount:g}"),
    ]
    if "tabular" in entry.kind:
        model = bnprl_envs.model(entry.id)
        rows += [
            ("states", f"{model.n_states}"),
            ("actions", " x ".join(map(str, model.action_sizes))),
            (
                "observations",
                "the state"
                if model.fully_observed
                else " x ".join(map(str, model.observation_sizes)),
            ),
        ]
    return markdown_table([["", ""], *rows], numbers=False)


def usage(entry: Entry) -> str:
    """Return the lines that make the environment and its batch."""
    factory = entry.factory.split(":")[1]
    if entry.kind == "parallel-tabular":
        batch = f'envs = bnprl_envs.TabularParallelBatch("{entry.id}", copies=1024)'
    elif entry.kind == "parallel-class":
        batch = f"envs = bnprl_envs.{factory}Batch(copies=1024)"
    else:
        batch = f'envs = gym.make_vec("{entry.id}", num_envs=1024)'
    if entry.kind.startswith("parallel"):
        made = f'import pettingzoo\n\nenv = pettingzoo.make("parallel", "{entry.id}")\n{batch}'
    else:
        made = f'import gymnasium as gym\n\nenv = gym.make("{entry.id}")\n{batch}'
    if "tabular" in entry.kind:
        made += f'\nmodel = bnprl_envs.model("{entry.id}")'
    return f"import bnprl_envs\n{made}"


def description(entry: Entry) -> str:
    """Return the sections of the docstring of what stands behind an entry."""
    module, factory = entry.factory.split(":")
    text = inspect.getdoc(getattr(import_module(module), factory)) or ""
    sections = text[text.index("## ") :]
    sections = re.split(r"^(?:Args|Returns|Attributes|Raises):$", sections, flags=re.MULTILINE)[0]
    return sections.replace("::\n", ":\n").strip()


def values(entry: Entry) -> str:
    """Return the table of reference values, with listed policies below it."""
    rows = [
        (REFERENCE_NAMES.get(r.name, r.name), f"{r.value:.9g}", r.source) for r in entry.references
    ]
    text = markdown_table([["policy or bound", "value", "source"], *rows], numbers=False)
    for reference in {r.policy: r for r in entry.references if r.policy}.values():
        lists = "\n".join(str(list(actions)) for actions in reference.policy)
        text += (
            f"\n\nThe listed memoryless policy of value {reference.value:.9g}, one line an agent: "
            "its action after each of its own observations, and last its first action.\n\n"
            f"```text\n{lists}\n```"
        )
    return text


def listing(entries: Sequence[Entry]) -> str:
    """Return the page that lists the environments."""
    rows = [
        (f"[{name(entry)}]({name(entry)}.md)", FORMS[entry.kind], entry.summary)
        for entry in entries
    ]
    toctree = "\n".join(name(entry) for entry in entries)
    return f"""# Environments

{markdown_table([["environment", "form", "what it is"], *rows], numbers=False)}

```{{toctree}}
:hidden:

{toctree}
```
"""


if __name__ == "__main__":
    write_pages(Path(__file__).parent / "environments")
