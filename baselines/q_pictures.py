"""Pictures of learned action values over the plane of the states."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from baselines.curves import COLOURS, LIGHT, dress, plain
from bnprl_agents.gaussian_process.gp_q import GPQ
from bnprl_agents.value_learner import ValueAgent
from bnprl_envs.tables import FloatArray

INK = LIGHT.ink
RESOLUTION = 60
ARROWS = 15
"""Arrows along each side of a plane that is continuous."""
COMPASS = ((0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0))
"""Directions on the picture of north, south, east, west, the order of the suite's grids."""


class Plane:
    """The plane of a learner's states: what is drawn where.

    Args:
        agent: whose observations are points of a plane.

    Raises:
        ValueError: they are not.
    """

    def __init__(self, agent: ValueAgent) -> None:
        features = agent.features
        if features.dimensions != 2:
            raise ValueError(
                f"a picture needs states in a plane, these have {features.dimensions} dimensions"
            )
        self.is_grid = len(features.points) > 0
        if self.is_grid:
            self.rows, self.columns = (int(n) + 1 for n in features.points.max(axis=0))
            self.extent = (-0.5, self.columns - 0.5, self.rows - 0.5, -0.5)
        else:
            (x0, y0), (x1, y1) = features.offset, features.offset + features.range
            self.extent = (x0, x1, y0, y1)
        self._features = features

    def mesh(self, resolution: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the points (n * n, 2) of a mesh, and its axes x and y; cells of a grid."""
        if self.is_grid:
            return self._features.points, np.arange(self.columns * 1.0), np.arange(self.rows * 1.0)
        share = (np.arange(resolution) + 0.5) / resolution
        u, v = np.meshgrid(share, share)
        x, y = (self._features.offset + self._features.range * share[:, None]).T
        return np.stack([u.ravel(), v.ravel()], axis=1), x, y

    def placed(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where points (n, 2) of the features are on the picture."""
        if self.is_grid:
            return points[:, 1], points[:, 0]
        x, y = (self._features.offset + self._features.range * points).T
        return x, y


def draw_values(
    agent: ValueAgent, *, axes: Sequence[str], actions: Sequence[str], compass: bool, title: str
) -> bytes:
    """Return a picture (PNG) of the values, their uncertainty and the greedy policy.

    Args:
        agent: what is drawn.
        axes: names of the two axes; (): numbers, of a grid column and row.
        actions: names; (): numbers.
        compass: whether its four actions are moves to the north, south, east and west, which are
            drawn as arrows; else actions are colours.
        title: above the picture.

    Raises:
        ValueError: its states do not lie in a plane.
    """
    plane = Plane(agent)
    uncertain = isinstance(agent, GPQ)
    figure = Figure(
        figsize=(16.5 if uncertain else 11.0, 5.0), facecolor=LIGHT.paper, layout="constrained"
    )
    every = figure.subplots(1, 3 if uncertain else 2)
    points, x, y = plane.mesh(RESOLUTION)
    values = agent.values(points)
    shape = (len(y), len(x))
    _draw_map(figure, every[0], plane, values.max(axis=1).reshape(shape), "value: max Q(s, a)")
    if isinstance(agent, GPQ):
        greedy = values.argmax(axis=1)[:, None]
        spread = np.sqrt(np.maximum(np.take_along_axis(agent.variances(points), greedy, 1), 0.0))
        label = "standard deviation of Q(s, a) at the greedy action"
        _draw_map(figure, every[1], plane, spread.reshape(shape), label, colours="magma")
        for action, basis in enumerate(agent.basis_points()):
            where = plane.placed(basis[:, :2])
            for place in every[:2]:
                place.plot(
                    *where,
                    ".",
                    scalex=False,
                    scaley=False,
                    ms=5,
                    mec=INK,
                    mew=0.4,
                    color=COLOURS[action % len(COLOURS)],
                )
    names = actions or [f"action {a}" for a in range(agent.n_actions)]
    _draw_policy(every[-1], plane, agent, names, compass)
    unnamed = ("column", "row") if plane.is_grid else ("observation 0", "observation 1")
    across, upwards = axes or unnamed
    for place in every:
        place.set(xlabel=plain(across), ylabel=plain(upwards))
        dress(place, LIGHT)
        place.grid(visible=False)
    figure.suptitle(plain(title), color=INK, fontsize=13)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=120, metadata={"Software": None})
    return picture.getvalue()


def _draw_map(
    figure: Figure,
    axes: Axes,
    plane: Plane,
    values: FloatArray,
    label: str,
    colours: Any = "viridis",
) -> None:
    origin: Any = "upper" if plane.is_grid else "lower"
    image = axes.imshow(values, extent=plane.extent, origin=origin, aspect="auto", cmap=colours)
    axes.set(xlim=plane.extent[:2], ylim=plane.extent[2:])
    figure.colorbar(image, ax=axes)
    axes.set_title(label, color=INK, fontsize=11)


def _draw_policy(
    axes: Axes, plane: Plane, agent: ValueAgent, names: Sequence[str], compass: bool
) -> None:
    points, x, y = plane.mesh(ARROWS if compass else RESOLUTION)
    best = agent.values(points).argmax(axis=1)
    axes.set_title("greedy policy", color=INK, fontsize=11)
    if compass:
        where = plane.placed(points)
        direction = np.array(COMPASS)[best]
        axes.quiver(*where, *direction.T, pivot="mid", scale=1.2 * len(x), width=0.006, color=INK)
        axes.set(xlim=plane.extent[:2], ylim=plane.extent[2:])
        return
    colours = ListedColormap([COLOURS[a % len(COLOURS)] for a in range(agent.n_actions)])
    origin: Any = "upper" if plane.is_grid else "lower"
    axes.imshow(
        best.reshape(len(y), len(x)),
        extent=plane.extent,
        origin=origin,
        aspect="auto",
        cmap=colours,
        vmin=-0.5,
        vmax=agent.n_actions - 0.5,
    )
    handles = [Patch(color=colours(a), label=plain(name)) for a, name in enumerate(names)]
    axes.legend(handles=handles, frameon=True, fontsize=9, loc="upper right")
