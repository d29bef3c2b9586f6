"""Behaviour cloning: actor, critic and normaliser of PPO begin where demonstrations leave them."""

# SB3 and torch are only partly typed
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false

import numpy as np
import torch
from pydantic import Field
from torch import nn

from pipeline.errors import PolicyError
from pipeline.locomotion.demonstrations import Demonstrations
from pipeline.ppo.training import Training
from schemas.base import Frozen


class CloneConfig(Frozen):
    """Numbers of a cloning."""

    epochs: int = Field(default=30, ge=1, description="times that every demonstrated tick is used")
    batch: int = Field(default=512, ge=2, description="ticks of a gradient step")
    learning_rate: float = Field(default=1e-3, gt=0, description="of Adam at the start; falls evenly to 0")
    critic: float = Field(default=0.5, ge=0, description="weight of the critic's loss; 0 leaves the critic as it is")
    steady: float = Field(default=1e7, gt=0, description="ticks that mean and spread of what the expert met count as "
                                                         "once PPO goes on: were they to move, what it does would, too")
    held_out: float = Field(default=0.1, ge=0, lt=0.5, description="share of the attempts that nothing is learned from")


class Epoch(Frozen):
    """One pass over the demonstrations."""

    actor: float = Field(description="mean squared distance to the expert's actions, in shares, while it learned")
    held_out: float | None = Field(description="the same in attempts that were held out, after the epoch")
    critic: float | None = Field(description="mean squared error of the worth, held out where attempts are")


def clone(training: Training, shown: Demonstrations, config: CloneConfig, *, seed: int) -> list[Epoch]:
    """Teach a training that has not begun what an expert did; its optimiser stays fresh.

    The normaliser takes mean and spread of all that the expert met, attempts in which it fell included, and hardly
    moves from there; rewards are scaled as PPO will scale them.

    Args:
        training: whose networks and normaliser are taught.
        shown: the demonstrations.
        config: how.
        seed: of the order of batches.

    Raises:
        PolicyError: the training has begun, or the demonstrations are of a robot that senses something else.
    """
    order, normaliser, policy = training.order, training.env.normaliser, training.model.policy
    if training.steps:
        raise PolicyError("this training has begun already", where=training.folder, mend="clone into another folder")
    if shown.sensed.shape[2] != len(normaliser.mean):
        raise PolicyError(f"the expert senses {shown.sensed.shape[2]} values, the robot {len(normaliser.mean)}",
                          where=f"{order.body} {order.name}", mend="clone an expert of this body and task")
    kept = len(shown.sensed)
    last = kept - (round(kept * config.held_out) if kept > 1 else 0)
    normaliser.update(shown.met)
    normaliser.count = config.steady
    learned, held = (_rows(training, shown, part) for part in (slice(0, last), slice(last, kept)))
    optimiser = torch.optim.Adam(policy.parameters(), lr=config.learning_rate)
    steps = config.epochs * -(-len(learned[0]) // config.batch)
    schedule = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.0, steps)
    draws = torch.Generator().manual_seed(seed)
    told: list[Epoch] = []
    for _ in range(config.epochs):
        losses: list[float] = []
        for batch in torch.randperm(len(learned[0]), generator=draws).split(config.batch):
            actor, critic = _losses(policy, *(part[batch] for part in learned))
            loss = actor + config.critic * critic if config.critic else actor
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(policy.parameters(), order.ppo.gradient)
            optimiser.step()
            schedule.step()
            losses.append(actor.item())
        told.append(_epoch(policy, float(np.mean(losses)), learned, held))
    return told


def _rows(training: Training, shown: Demonstrations, part: slice) -> tuple[torch.Tensor, ...]:
    """What is sensed, normalised; the actions; the worth, scaled; a row a tick."""
    width, joints = shown.sensed.shape[2], shown.action.shape[2]
    return (torch.from_numpy(training.env.normaliser(shown.sensed[part].reshape(-1, width))),
            torch.from_numpy(shown.action[part].reshape(-1, joints).astype(np.float32)),
            torch.from_numpy((training.order.ppo.reward_scale * shown.worth[part].reshape(-1)).astype(np.float32)))


def _losses(policy: nn.Module, sensed: torch.Tensor, action: torch.Tensor,
            worth: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean squared errors of actions and of the worth where it is known."""
    latent: nn.Module = policy.mlp_extractor  # pyright: ignore[reportAssignmentType]
    mean = policy.action_net(latent.forward_actor(sensed))  # pyright: ignore[reportCallIssue]
    value = policy.value_net(latent.forward_critic(sensed)).flatten()  # pyright: ignore[reportCallIssue]
    known = torch.isfinite(worth)
    apart = torch.where(known, value - torch.nan_to_num(worth), 0.0)
    return ((mean - action) ** 2).mean(), (apart**2).sum() / known.sum().clamp(min=1)


def _epoch(policy: nn.Module, actor: float, learned: tuple[torch.Tensor, ...],
           held: tuple[torch.Tensor, ...]) -> Epoch:
    with torch.no_grad():
        found, critic = _losses(policy, *(held if len(held[0]) else learned))
    return Epoch(actor=actor, held_out=found.item() if len(held[0]) else None, critic=critic.item())
