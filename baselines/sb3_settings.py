"""Settings of Stable-Baselines3's learners as data; importing this module does not import that."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar, Literal

from bnprl_agents.settings import Settings

Team = Literal["shared", "independent"] | None
"""How a team's agents learn: by one network for all, or by one each; None: one agent only."""


@dataclass(frozen=True)
class OnPolicySettings(Settings):
    """Settings that the actor-critic learners share.

    The defaults were chosen on `bnprl/Hallway-v0` at 150,000 steps, from a few runs of one or
    two seeds each; they are not those of Stable-Baselines3. There four stacked observations
    did better than one for every learner without memory.

    Raises:
        ValueError: a number is out of range.
    """

    team: ClassVar[Team] = None

    n_envs: int = 16
    """Copies of the environment that are stepped together."""
    n_steps: int = 128
    """Steps of each copy between two updates."""
    learning_rate: float = 1e-3
    """Step size of the optimiser, constant."""
    gae_lambda: float = 0.95
    """Decay of generalised advantage estimation, in [0, 1]."""
    entropy: float = 0.01
    """Weight of the entropy bonus."""
    frame_stack: int = 4
    """Last observations that the policy sees, where they are discrete; 1 is memoryless."""
    hidden_units: int = 64
    """Units of each of the two hidden layers of the actor and of the critic."""
    scale_rewards: bool = False
    """Divide the rewards by the running spread of the discounted returns."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_counts(self)

    @property
    def rollout_steps(self) -> int:
        """Environment steps of all copies between two updates."""
        return self.n_envs * self.n_steps


@dataclass(frozen=True)
class A2CSettings(OnPolicySettings):
    """Advantage actor-critic.

    One gradient step an update, so updates are frequent and large: rollouts of 16 steps at a
    learning rate of 1e-3 learned more slowly on Hallway (one seed).
    """

    n_steps: int = 8
    """Steps of each copy between two updates."""
    learning_rate: float = 3e-3
    """Step size of the optimiser, constant."""


@dataclass(frozen=True)
class PPOSettings(OnPolicySettings):
    """Proximal policy optimisation on a short stack of observations."""

    batch_size: int = 512
    """Steps of a minibatch."""
    n_epochs: int = 5
    """Passes over the steps of one update."""
    clip_range: float = 0.2
    """Largest change of an action's probability ratio that is rewarded."""


@dataclass(frozen=True)
class RecurrentPPOSettings(PPOSettings):
    """Proximal policy optimisation with a recurrent policy, which needs no stack.

    Many copies, a small LSTM and large minibatches, because the defaults of
    Stable-Baselines3 are slow on tasks as small as these.
    """

    frame_stack: int = 1
    """Last observations that the policy sees, where they are discrete."""
    lstm_units: int = 64
    """Units of the LSTM of the actor and of that of the critic."""


@dataclass(frozen=True)
class SharedPPOSettings(PPOSettings):
    """Proximal policy optimisation by one network for all agents of a team.

    The network sees an agent's own observations and which agent it is, as a one-hot index, so
    the agents may still act differently. Each agent's steps count as those of one more copy.
    """

    team: ClassVar[Team] = "shared"

    n_steps: int = 100
    """Steps of each copy between two updates."""
    batch_size: int = 400
    """Steps of a minibatch; a rollout is a multiple of it for any number of agents."""
    scale_rewards: bool = True
    """Divide the rewards, up to 100 in size, by the running spread of the discounted returns."""


@dataclass(frozen=True)
class IndependentPPOSettings(PPOSettings):
    """Proximal policy optimisation by one network an agent; the others are its environment."""

    team: ClassVar[Team] = "independent"

    n_steps: int = 100
    """Steps of each copy between two updates."""
    batch_size: int = 400
    """Steps of a minibatch; a rollout is a multiple of it for any number of agents."""
    scale_rewards: bool = True
    """Divide the rewards, up to 100 in size, by the running spread of the discounted returns."""


@dataclass(frozen=True)
class SharedRecurrentPPOSettings(RecurrentPPOSettings):
    """Proximal policy optimisation by one recurrent network for all agents of a team."""

    team: ClassVar[Team] = "shared"

    n_steps: int = 100
    """Steps of each copy between two updates."""
    batch_size: int = 400
    """Steps of a minibatch; a rollout is a multiple of it for any number of agents."""
    scale_rewards: bool = True
    """Divide the rewards, up to 100 in size, by the running spread of the discounted returns."""


@dataclass(frozen=True)
class DQNSettings(Settings):
    """Deep Q-network; its policy is greedy, so on a single observation it may loop for ever.

    On Hallway, with one seed, it learned nothing from one observation at a time.

    Raises:
        ValueError: a number is out of range.
    """

    team: ClassVar[Team] = None

    n_envs: int = 8
    """Copies of the environment that are stepped together."""
    learning_rate: float = 1e-3
    """Step size of the optimiser, constant."""
    buffer_size: int = 100_000
    """Transitions kept for replay."""
    batch_size: int = 128
    """Transitions of a minibatch."""
    learning_starts: int = 2_000
    """Environment steps by random actions before learning begins."""
    train_freq: int = 2
    """Steps of each copy between two rounds of gradient steps."""
    gradient_steps: int = 2
    """Gradient steps of one round."""
    target_update: int = 2_000
    """Environment steps between two copies of the network into the target network."""
    exploration_fraction: float = 0.3
    """Share of the whole budget over which epsilon falls linearly from 1 to its final value."""
    exploration_final: float = 0.05
    """Final probability of a random action while learning."""
    frame_stack: int = 4
    """Last observations that the policy sees, where they are discrete; 1 is memoryless."""
    hidden_units: int = 64
    """Units of each of the two hidden layers."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_counts(self)
        if not 0.0 < self.exploration_fraction <= 1.0:
            raise ValueError(
                f"exploration_fraction: {self.exploration_fraction}, must lie in (0, 1]"
            )
        if not 0.0 <= self.exploration_final <= 1.0:
            raise ValueError(f"exploration_final: {self.exploration_final}, must lie in [0, 1]")

    @property
    def rollout_steps(self) -> int:
        """Environment steps between two reports, a multiple of those between two updates."""
        each = self.n_envs * self.train_freq
        return each * max(1, 1_000 // each)


SB3Settings = A2CSettings | PPOSettings | RecurrentPPOSettings | DQNSettings


def _check_counts(settings: OnPolicySettings | DQNSettings) -> None:
    """Check that every integer is at least 1, and a step size positive."""
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if type(value) is int and value < 1:
            raise ValueError(f"{field.name}: {value}, must be at least 1")
    if not settings.learning_rate > 0.0:
        raise ValueError(f"learning_rate: {settings.learning_rate}, must be positive")
