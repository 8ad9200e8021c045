"""`bnprl watch`: episodes of a policy as text, as a GIF or in a window."""

from __future__ import annotations

import contextlib
import functools
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import pettingzoo
from tqdm import tqdm

from baselines.environment import EnvironmentSpec, made_elsewhere
from baselines.evaluation import Policy
from baselines.learners import load_policy
from baselines.usage import usage_errors
from baselines.watch_pictures import beside, beside_as_text, write_gif
from bnprl_agents.history_agent import PolicyState
from bnprl_envs import registry
from bnprl_envs.model import TabularModel
from bnprl_envs.planning import belief_update
from bnprl_envs.tables import FloatArray

if TYPE_CHECKING:
    from baselines.options import Watch


@dataclass(frozen=True)
class Sight:
    """What there is to see at one step.

    Attributes:
        picture: lines of text, or an array (height, width, 3).
        episode: which, from 1.
        value: discounted return so far.
        nodes: (Z,) node distribution of each agent's controller; none for other policies.
        over: whether the episode ends here.
    """

    picture: Any
    episode: int
    value: float
    nodes: tuple[FloatArray, ...]
    over: bool


class RandomPolicy:
    """Uniformly random actions, in any space, of one agent or many.

    Args:
        env: Gymnasium's or PettingZoo's.
        rng: source of the seeds of the spaces.
    """

    def __init__(self, env: Any, rng: np.random.Generator) -> None:
        self._spaces = _spaces(env, "action")
        for space in self._spaces.values() if self._many else [self._spaces]:
            space.seed(int(rng.integers(2**31)))

    @property
    def _many(self) -> bool:
        return isinstance(self._spaces, dict)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Draw an action; see `Agent.predict`."""
        if self._many:
            return {agent: self._spaces[agent].sample() for agent in observation}, None
        return self._spaces.sample(), None


def watch(options: Watch) -> int:
    """Run episodes and show them."""
    mode = "ansi" if options.gif is None and not options.human else "rgb_array"
    with usage_errors():
        _check(options)
        environment = EnvironmentSpec(options.id)
        env = make_env(environment, mode)
        rng = np.random.default_rng(options.seed)
        policy = _policy(options, env, rng)
        model = _known_model(env) if options.belief else None
    sights = _sights(env, policy, environment.discount, model, options, rng)
    with contextlib.closing(env), usage_errors():
        fps = int(env.metadata.get("render_fps", 4))
        if options.gif is not None:
            _make_gif(sights, options.gif, fps, options.progress)
        elif options.human:
            _show_window(sights, options.id, fps)
        else:
            _print(sights, fps)
    return 0


def make_env(environment: EnvironmentSpec, mode: str) -> Any:
    """Make one copy of an environment to look at: PettingZoo's of a team, else Gymnasium's.

    Raises:
        ValueError: there is no such environment, or it cannot be made or looked at in this mode.
        OSError: the model file cannot be read.
    """
    if environment.id in registry.environment_ids():
        if not registry.entry(environment.id).kind.startswith("parallel"):
            return gym.make(environment.id, render_mode=mode)
        return pettingzoo.make("parallel", environment.id, render_mode=mode)
    if (model := environment.model()) is not None:
        from bnprl_envs.tabular import TabularEnv
        from bnprl_envs.tabular_parallel import TabularParallelEnv

        view = TabularEnv if model.n_agents == 1 else TabularParallelEnv
        return view(model, max_episode_steps=environment.horizon, render_mode=mode)
    make = functools.partial(gym.make, environment.name)
    if environment.has_several_agents():
        make = functools.partial(pettingzoo.make, "parallel", environment.name)
    with made_elsewhere(environment.id):
        with contextlib.closing(make()) as env:
            modes = env.metadata.get("render_modes", ())
        if mode in modes:
            return make(render_mode=mode)
    raise ValueError(f"{environment.id} renders as {', '.join(modes) or 'nothing'}, not {mode}")


def _check(options: Watch) -> None:
    for name, value, least in (
        ("episodes", options.episodes, 1),
        ("steps", options.steps, 1),
        ("seed", options.seed, 0),
    ):
        if value is not None and value < least:
            raise ValueError(f"--{name}: {value}, must be at least {least}")
    if options.agent is not None and options.policy is None:
        raise ValueError(f"--agent: {options.agent}, of what policy? give --policy FILE too")
    if options.gif is not None and options.human:
        raise ValueError("--gif, --human: give one of them")
    if options.gif is not None and options.gif.suffix.lower() != ".gif":
        raise ValueError(f"--gif: {options.gif}, must end in .gif")
    if options.gif is not None and not options.gif.resolve().parent.is_dir():
        raise ValueError(f"--gif: there is no folder {options.gif.resolve().parent}")
    if options.human:
        from bnprl_envs.rendering.window import import_pygame

        import_pygame()


def _policy(options: Watch, env: Any, rng: np.random.Generator) -> Policy:
    if options.policy is None:
        return RandomPolicy(env, rng)
    policy: Any = load_policy(options.policy, options.agent)
    for kind in ("observation", "action"):
        made_for, here = getattr(policy, f"{kind}_space", None), _spaces(env, kind)
        if made_for is not None and made_for != here:
            raise ValueError(
                f"the policy's {kind}_space is {made_for}, the environment's is {here}"
            )
    if hasattr(policy, "predict_rng"):
        policy.predict_rng = rng.spawn(1)[0]
    known: Policy = policy
    return known


def _spaces(env: Any, kind: str) -> Any:
    """Return the space of one agent, or a dict of those of all agents."""
    space = getattr(env, f"{kind}_space")
    return {a: space(a) for a in env.possible_agents} if hasattr(env, "possible_agents") else space


def _known_model(env: Any) -> TabularModel:
    """Return the model whose belief is to be shown.

    Raises:
        ValueError: there is none, it has several agents, or its state is seen.
    """
    model = getattr(env.unwrapped, "model", None)
    if not isinstance(model, TabularModel) or model.n_agents > 1 or model.fully_observed:
        raise ValueError("--belief needs one agent that sees its known model only in part")
    return model


def _sights(
    env: Any,
    policy: Policy,
    discount: float,
    model: TabularModel | None,
    options: Watch,
    rng: np.random.Generator,
) -> Iterator[Sight]:
    """Run the episodes and yield what there is to see, first after each reset."""
    seeds = [int(rng.integers(2**31)), *[None] * (options.episodes - 1)]
    for episode, seed in enumerate(seeds, start=1):
        observation, _ = env.reset(seed=seed)
        belief = None if model is None else model.start
        state, value, weight, step, over = None, 0.0, 1.0, 0, False
        while True:
            if model is not None:
                env.unwrapped.belief = belief
            action, after = policy.predict(observation, state, None, False)
            yield Sight(env.render(), episode, value, _nodes(after), over)
            if over:
                break
            state = after
            observation, reward, over = _step(env, action)
            value, weight, step = value + weight * reward, weight * discount, step + 1
            over |= step == options.steps
            if model is not None and belief is not None:
                belief, _ = belief_update(model, belief, int(action), int(observation))


def _step(env: Any, action: Any) -> tuple[Any, float, bool]:
    """Return the observation (a dict of a team), the reward, and whether the episode is over."""
    observation, reward, terminated, truncated, _ = env.step(action)
    if isinstance(reward, dict):
        return observation, float(next(iter(reward.values()))), not env.agents
    return observation, float(reward), bool(terminated or truncated)


def _nodes(state: Any) -> tuple[FloatArray, ...]:
    """Return the node distributions (Z,) in the state that a controller's `predict` returned."""
    if not isinstance(state, PolicyState):
        return ()
    beliefs = (state.belief,) if isinstance(state.belief, np.ndarray) else state.belief
    return tuple(each[0] for each in beliefs)


def _print(sights: Iterator[Sight], fps: int) -> None:
    """Print one sight below the other, or on a terminal in place and at the pace of the frames."""
    live = sys.stdout.isatty()
    for sight in sights:
        text = f"{sight.picture}\n{beside_as_text(sight.episode, sight.value, sight.nodes)}\n"
        print(f"\x1b[H\x1b[J{text}" if live else text, flush=live)
        if live:
            time.sleep(1 / fps)


def _show_window(sights: Iterator[Sight], title: str, fps: int) -> None:
    from bnprl_envs.rendering.window import Window

    window = None
    for sight in sights:
        frame = beside(sight.picture, sight.episode, sight.value, sight.nodes)
        window = window or Window(f"bnprl watch {title}", frame.shape)
        window.show(frame, fps)
    if window is not None:
        window.close()


def _make_gif(sights: Iterator[Sight], path: Path, fps: int, progress: bool) -> None:
    shown, held = 1000 // fps, 3000 // fps  # ms; an episode's last frame stays longer
    n_frames = write_gif(
        path,
        (
            (
                beside(sight.picture, sight.episode, sight.value, sight.nodes),
                held if sight.over else shown,
            )
            for sight in tqdm(sights, unit=" frames", disable=not progress, delay=1)
        ),
    )
    print(f"{path}: {n_frames} frames")
