"""A window that shows frames: pygame, imported only here."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt


class Window:
    """A window on the screen; pygame opens one at a time.

    Args:
        title: of the window.
        shape: height and width of the frames.

    Raises:
        ImportError: pygame is not installed; the message says what to install.
    """

    def __init__(self, title: str, shape: tuple[int, ...]) -> None:
        self._pygame = import_pygame()
        self._pygame.display.init()
        self._pygame.display.set_caption(title)
        self._surface = self._pygame.display.set_mode((shape[1], shape[0]))
        self._clock = self._pygame.time.Clock()

    def show(self, frame: npt.NDArray[np.uint8], fps: int) -> None:
        """Show a frame, at most `fps` a second."""
        self._pygame.surfarray.blit_array(self._surface, frame.swapaxes(0, 1))
        self._pygame.event.pump()
        self._pygame.display.flip()
        self._clock.tick(fps)

    def close(self) -> None:
        """Close the window."""
        self._pygame.display.quit()


def import_pygame() -> Any:
    """Return the module.

    Raises:
        ImportError: it is not installed; the message says what to install.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame
    except ImportError as error:
        raise ImportError('render_mode "human" needs pygame: pip install "bnprl[human]"') from error
    return pygame
