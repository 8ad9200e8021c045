"""Looking at environments: plain text, pixels, or a window.

A benchmark describes its layout as data, a `Scene`, in a function beside its model: the model of
`module:name` looks as `module:name_scene` says, or like a card of its labels if there is no such
function. Nothing here imports Pillow or pygame before something is drawn.
"""

from bnprl_envs.rendering.rendered import RENDER_MODES, Rendered
from bnprl_envs.rendering.scene import Doing, Moment, Scene, as_text, frame
from bnprl_envs.rendering.theme import FRAME_SHAPE

__all__ = [
    "FRAME_SHAPE",
    "RENDER_MODES",
    "Doing",
    "Moment",
    "Rendered",
    "Scene",
    "as_text",
    "frame",
]
