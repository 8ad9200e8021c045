"""What makes an environment render: the modes, and a window that opens when first needed."""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Any

import gymnasium as gym

from bnprl_envs.arguments import checked_render_mode
from bnprl_envs.rendering.scene import Moment, Scene, as_text, frame
from bnprl_envs.rendering.theme import FRAME_SHAPE
from bnprl_envs.tables import FloatArray

if TYPE_CHECKING:
    from bnprl_envs.rendering.window import Window

RENDER_MODES = ("ansi", "rgb_array", "human")


class Rendered:
    """An environment that can be looked at, as plain text, as pixels, or in a window.

    A subclass says how its states look (`_make_scene`) and what there is to show (`_moment`), and
    calls `_show` after each reset and step.

    Attributes:
        render_mode: None, "ansi", "rgb_array" or "human".
        belief: (S,) distribution of the state of a tabular environment. A policy that holds one
            sets it after each step, and the pictures show it; `reset` clears it.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (declared so by Gymnasium)
        "render_modes": list(RENDER_MODES),
        "render_fps": 4,
        "render_shape": FRAME_SHAPE,
    }
    render_mode: str | None = None
    belief: FloatArray | None = None
    _window: Window | None = None

    def _set_render_mode(self, render_mode: str | None) -> None:
        self.render_mode = checked_render_mode(render_mode, RENDER_MODES)

    def render(self) -> Any:
        """Show the current state.

        Returns:
            Lines of plain text (ansi), a uint8 array of shape `metadata["render_shape"]`
            (rgb_array), or None: the window is up to date (human).

        Raises:
            ResetNeeded: before the first reset.
            ImportError: human, and pygame is not installed.
        """
        if self.render_mode is None:
            gym.logger.warn("render() shows nothing: no render_mode was given to the constructor")
            return None
        if self.render_mode == "ansi":
            return as_text(self._scene, self._moment())
        picture = frame(self._scene, self._moment())
        if self.render_mode == "rgb_array":
            return picture
        if self._window is None:
            from bnprl_envs.rendering.window import Window  # pygame

            self._window = Window(str(self), picture.shape)
        self._window.show(picture, self.metadata["render_fps"])
        return None

    def close(self) -> None:
        """Close the window, if one is open."""
        if self._window is not None:
            self._window.close()
            self._window = None

    @cached_property
    def _scene(self) -> Scene:
        return self._make_scene()

    def _show(self) -> None:
        """Bring the window up to date, if that is how the environment is looked at."""
        if self.render_mode == "human":
            self.render()

    @abstractmethod
    def _make_scene(self) -> Scene:
        """Return how states look."""

    @abstractmethod
    def _moment(self) -> Moment:
        """Return what there is to show."""
