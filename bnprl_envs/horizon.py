"""After how many steps an environment of any kind cuts its episodes."""

from __future__ import annotations

from typing import Any


def horizon_of(env: Any) -> int | None:
    """Return after how many steps an environment's episodes are cut; None: it does not say.

    This suite's environments have `max_episode_steps`, Gymnasium's have it in their `spec`, and
    PettingZoo's keep their `max_cycles`, as the argument is called there.
    """
    inner = getattr(env, "unwrapped", env)
    places = ((env, "max_episode_steps"), (inner, "max_episode_steps"), (inner, "max_cycles"))
    for place, name in (*places, (getattr(env, "spec", None), "max_episode_steps")):
        limit: int | None = getattr(place, name, None)
        if limit is not None:
            return limit
    return None
