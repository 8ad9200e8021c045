"""A learned controller as a graph, and its nodes and exploration over learning."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch, Patch

from baselines.curves import COLOURS, LIGHT, dress, newest, plain, thousands
from baselines.records import Record
from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.messages import forward
from bnprl_agents.controllers.rollout import rollout
from bnprl_agents.episodes import EpisodeBatch, FloatArray
from bnprl_envs.model import TabularModel

EPISODES, HORIZON = 500, 251
"""Episodes of the policy from which its use of nodes and moves is taken."""
LEAST_NODE, LEAST_MOVE = 0.005, 0.1
"""Nodes with less of all steps and moves with less of their node's moves are not drawn."""
LABELLED = 12
"""Most moves that have their observation written beside them; of more the colours tell."""
METRICS = {"nodes": "nodes in use", "exploring": "share of steps that explore"}


@dataclass(frozen=True)
class Usage:
    """What a controller's nodes did in some episodes.

    Attributes:
        nodes: (Z,) share of all steps.
        actions: (Z, A) actions in each node, rows summing to 1.
        moves: (O, Z, Z) share of all moves, by the observation that came with them.
    """

    nodes: FloatArray
    actions: FloatArray
    moves: FloatArray


def usage(model: TabularModel, controllers: Sequence[Controller], seed: int = 0) -> list[Usage]:
    """Simulate a policy and return the use of each agent's nodes, as filtered by its episodes."""
    rng = np.random.default_rng(seed)
    episodes = rollout(model, controllers, episodes=EPISODES, horizon=HORIZON, rng=rng)
    return [_usage(episodes, n, controller) for n, controller in enumerate(controllers)]


def _usage(episodes: EpisodeBatch, agent: int, controller: Controller) -> Usage:
    alpha = forward(episodes, agent, controller).alpha
    seen, done = episodes.observations[:, agent], episodes.actions[:, agent]
    moves = np.zeros((controller.n_observations, controller.n_nodes, controller.n_nodes))
    inside = np.ones(episodes.n_steps, dtype=bool)
    inside[episodes.offsets[:-1]] = False
    pairs = np.stack([done[:-1], seen[1:]], axis=1)[inside[1:]]
    before = alpha[:-1][inside[1:]]
    for action, observation in np.unique(pairs, axis=0):
        here = (pairs == (action, observation)).all(axis=1)
        held = before[here].sum(axis=0)
        moves[observation] += held[:, None] * controller.successor[action, observation]
    return Usage(alpha.mean(axis=0), controller.action, moves / max(moves.sum(), 1e-300))


def draw_controllers(
    model: TabularModel,
    controllers: Sequence[Controller],
    runs: Sequence[Record],
    title: str,
) -> bytes:
    """Return a picture (PNG): a graph for each agent, and curves where there are records.

    Args:
        model: what the policy acts in.
        controllers: one for each agent.
        runs: records of the run that learned them, oldest first; may be empty.
        title: above the picture.
    """
    curves = {
        label: [(r.steps, r.metrics[name]) for r in newest(runs) if name in r.metrics]
        for name, label in METRICS.items()
    }
    curves = {label: points for label, points in curves.items() if len(points) > 1}
    n = len(controllers)
    figure = Figure(
        figsize=(8.4 * n, 8.6 if curves else 6.8), facecolor=LIGHT.paper, layout="constrained"
    )
    heights = [6.0, 1.6] if curves else [6.0]
    top, *below = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False).ravel()
    graphs = top.subplots(1, n, squeeze=False).ravel()
    names = model.names
    for agent, (axes, used) in enumerate(zip(graphs, usage(model, controllers), strict=True)):
        words = (*names.observations[agent], "start")
        draw_graph(axes, used, names.actions[agent], words)
        if n > 1:
            axes.set_title(f"agent_{agent}", color=LIGHT.ink, fontsize=11)
    for part in below:
        for axes, (label, points) in zip(
            part.subplots(1, len(curves), squeeze=False).ravel(), curves.items(), strict=True
        ):
            _draw_curve(axes, label, points)
    figure.suptitle(plain(title), color=LIGHT.ink, fontsize=13)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=120, metadata={"Software": None})
    return picture.getvalue()


def draw_graph(
    axes: Axes, used: Usage, action_names: Sequence[str], observation_names: Sequence[str]
) -> None:
    """Draw nodes, sized by occupancy, and moves, coloured by their most frequent observation."""
    held = np.flatnonzero(used.nodes >= LEAST_NODE)
    held = held[np.argsort(used.actions[held].argmax(axis=1), kind="stable")]
    angle = np.pi / 2 - 2 * np.pi * np.arange(held.size) / max(held.size, 1)
    place = np.stack([np.cos(angle), np.sin(angle)], axis=1) * (held.size > 1)
    radius = 0.07 + 0.17 * np.sqrt(used.nodes[held])
    total, kind = used.moves.sum(axis=0), used.moves.argmax(axis=0)
    leaving = total.sum(axis=1)
    moves = [
        (i, j)
        for i in range(held.size)
        for j in range(held.size)
        if total[held[i], held[j]] > LEAST_MOVE * leaving[held[i]]
    ]
    shown = sorted({int(kind[held[i], held[j]]) for i, j in moves})
    colours = {o: to_hex(colormaps["tab20"](k % 20)) for k, o in enumerate(shown)}
    for i, j in moves:
        share, seen = total[held[i], held[j]], int(kind[held[i], held[j]])
        text = observation_names[seen] if len(moves) <= LABELLED else ""
        _draw_move(axes, place[i], place[j], radius[i], radius[j], share, colours[seen], text)
    for position, size, z in zip(place, radius, held, strict=True):
        chosen = int(used.actions[z].argmax())
        colour = COLOURS[chosen % len(COLOURS)]
        axes.add_artist(_circle(position, size, colour, float(used.actions[z, chosen])))
        axes.annotate(
            f"{z}\n{used.nodes[z]:.0%}",
            position,
            ha="center",
            va="center",
            fontsize=8,
            color=LIGHT.ink,
            zorder=4,
        )
    _dress_graph(axes, action_names, {observation_names[o]: c for o, c in colours.items()})


def _circle(position: FloatArray, size: float, colour: str, certainty: float) -> Patch:
    """A node: the surer its action, the stronger its colour."""
    return Circle(
        (float(position[0]), float(position[1])),
        size,
        facecolor=(colour, 0.15 + 0.6 * certainty),
        edgecolor=colour,
        linewidth=2.0,
        zorder=3,
    )


def _draw_move(
    axes: Axes,
    begin: FloatArray,
    end: FloatArray,
    begin_radius: float,
    end_radius: float,
    share: float,
    colour: str,
    text: str,
) -> None:
    """Draw one arrow, bent to the left so that both directions are seen, or a loop outwards."""
    outward = begin / max(float(np.hypot(*begin)), 1e-9) if begin.any() else np.array([0.0, 1.0])
    across = np.array([-outward[1], outward[0]])
    if np.array_equal(begin, end):
        tail = begin + begin_radius * (outward * 0.8 + across * 0.6)
        head = begin + begin_radius * (outward * 0.8 - across * 0.6)
        bend, label = -1.6, begin + outward * (begin_radius * 2.1 + 0.05)
    else:
        along = (end - begin) / np.hypot(*(end - begin))
        tail, head = begin + along * begin_radius, end - along * end_radius
        bend = 0.15
        label = (tail + head) / 2 + 0.08 * np.hypot(*(head - tail)) * np.array(
            [along[1], -along[0]]
        )
    axes.add_patch(
        FancyArrowPatch(
            (float(tail[0]), float(tail[1])),
            (float(head[0]), float(head[1])),
            connectionstyle=f"arc3,rad={bend}",
            arrowstyle="-|>",
            mutation_scale=11,
            linewidth=0.8 + 6.0 * np.sqrt(share),
            color=colour,
            alpha=0.75,
            shrinkA=0,
            shrinkB=0,
            zorder=2,
        )
    )
    where = (float(label[0]), float(label[1]))
    axes.annotate(
        plain(text), where, ha="center", va="center", fontsize=7, color=LIGHT.ink, zorder=5
    )


def _dress_graph(axes: Axes, action_names: Sequence[str], observations: dict[str, str]) -> None:
    axes.set(xlim=(-1.55, 1.55), ylim=(-1.5, 1.5), aspect="equal")
    axes.axis("off")
    actions = [
        Patch(color=COLOURS[a % len(COLOURS)], alpha=0.75, label=plain(f"action {name}"))
        for a, name in enumerate(action_names)
    ]
    moves = [
        Line2D([], [], color=c, lw=3, label=plain(f"sees {o}")) for o, c in observations.items()
    ]
    axes.legend(
        handles=[*actions, *moves],
        fontsize=7.5,
        frameon=False,
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
    )


def _draw_curve(axes: Axes, label: str, points: Sequence[tuple[int, float]]) -> None:
    steps, values = zip(*points, strict=True)
    axes.plot(steps, values, color=COLOURS[0], linewidth=1.8, marker="o", markersize=3)
    dress(axes, LIGHT)
    axes.set_ylabel(label, fontsize=9)
    axes.set_xlabel("environment steps of training", fontsize=9)
    axes.set_ylim(0.0, 1.08 * max(values) or 1.0)
    axes.xaxis.set_major_formatter(lambda value, _: thousands(value))
