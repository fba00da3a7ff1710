"""The three agents. Each is a network and a rule for the value of the next state:

    dqn                 NatureNetwork    max_a Q_target(s', a)
    double_dqn          NatureNetwork    Q_target(s', argmax_a Q_online(s', a))
    dueling_double_dqn  DuelingNetwork   Q_target(s', argmax_a Q_online(s', a))

Everything else, one gradient step on (r + gamma * value(s') - Q_online(s, a))^2, they share.
Names carry time as in dqn_zoo: s_tm1, a_tm1 -> r_t, s_t.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from atari_dqn.networks import DuelingNetwork, NatureNetwork
from atari_dqn.params import ParameterError, Parameters
from atari_dqn.replay import Batch


def q_learning(q_target_t: Tensor, s_t: Tensor, online: nn.Module) -> Tensor:
    """Value [B] of the next states (Mnih et al., 2015, algorithm 1). q_target_t: [B, A]."""
    return q_target_t.max(dim=1).values


def double_q_learning(q_target_t: Tensor, s_t: Tensor, online: nn.Module) -> Tensor:
    """Value [B] of the next states: the online network selects, the target network evaluates
    (van Hasselt et al., 2016, equation 4). q_target_t: [B, A]."""
    a_t = online(s_t).argmax(dim=1, keepdim=True)  # [B, 1]
    return q_target_t.gather(1, a_t).squeeze(1)


@dataclass(frozen=True)
class Agent:
    """What sets one agent apart from another."""

    title: str
    network: type[nn.Module]
    value: Callable[[Tensor, Tensor, nn.Module], Tensor]


AGENTS = {
    "dqn": Agent("DQN", NatureNetwork, q_learning),
    "double_dqn": Agent("Double DQN", NatureNetwork, double_q_learning),
    "dueling_double_dqn": Agent("Dueling Double DQN", DuelingNetwork, double_q_learning),
}


class Learner:
    """The online network, its target network and the optimiser."""

    def __init__(
        self,
        agent: Agent,
        actions: int,
        params: Parameters,
        seed: int,
        initial: dict[str, Tensor] | None = None,
    ):
        self.agent, self.params = agent, params
        self.device = torch_device(params.device)
        with torch.random.fork_rng():  # nothing but the initial weights is drawn from torch
            torch.manual_seed(seed)
            self.online = agent.network(params.frame_stack, actions).to(self.device)
            self.target = agent.network(params.frame_stack, actions).to(self.device)
        if initial is not None:
            transfer(initial, self.online, params.transferred_layers)
        self.online.convolutions.requires_grad_(not params.freeze_convolutions)
        self.target.load_state_dict(self.online.state_dict())
        self.target.requires_grad_(False)
        learned = [weight for weight in self.online.parameters() if weight.requires_grad]
        self.optimiser = torch.optim.Adam(
            learned, lr=params.learning_rate, eps=params.adam_epsilon, fused=True
        )
        self.updates = 0

    @torch.no_grad()
    def q_values(self, observations: np.ndarray) -> np.ndarray:
        """Bytes [N, 84, 84, S] to Q-values float32 [N, A]."""
        return self.online(self._tensor(observations)).cpu().numpy()

    def learn(self, batch: Batch, updates: int) -> tuple[float, float]:
        """Makes `updates` gradient steps, each on its share of the batch.

        The target network must not change in between, so that one pass serves them all; then it
        is updated if that is due. Returns the means of the loss and of Q(s_tm1, a_tm1).
        """
        s_t, a_tm1 = self._tensor(batch.s_t), self._tensor(batch.a_tm1)
        r_t, continues = self._tensor(batch.r_t), self._tensor(batch.continues)
        with torch.no_grad():
            q_target_t = self.target(s_t)  # [updates * B, A]
        losses, values = 0.0, 0.0
        size = len(a_tm1) // updates
        for share in (slice(k * size, (k + 1) * size) for k in range(updates)):
            with torch.no_grad():
                value_t = self.agent.value(q_target_t[share], s_t[share], self.online)  # [B]
                target = r_t[share] + self.params.gamma * continues[share] * value_t  # [B]
            q_tm1 = self.online(self._tensor(batch.s_tm1[share]))  # [B, A]
            q_a_tm1 = q_tm1.gather(1, a_tm1[share, None]).squeeze(1)  # [B]
            loss = nn.functional.mse_loss(q_a_tm1, target)
            self.optimiser.zero_grad()
            loss.backward()
            self.optimiser.step()
            self.updates += 1
            losses += loss.item()
            values += q_a_tm1.mean().item()
        if self.updates % self.params.target_update_period == 0:
            self._update_target()
        return losses / updates, values / updates

    def set_learning_rate(self, rate: float) -> None:
        for group in self.optimiser.param_groups:
            group["lr"] = rate

    def updates_until_target(self) -> int:
        """How many updates may be made before the target network changes."""
        period = self.params.target_update_period
        return period - self.updates % period

    @torch.no_grad()
    def _update_target(self) -> None:
        """Moves the target weights by the share `tau` towards the online ones; 1 copies them."""
        for theta_minus, theta in zip(
            self.target.parameters(), self.online.parameters(), strict=True
        ):
            theta_minus.lerp_(theta, self.params.tau)

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array).to(self.device)

    def get_state(self) -> dict[str, Any]:
        """Weights, the optimiser's moments and counters; every value a tensor or a number."""
        moments = {
            f"{name}.{key}": value
            for name, parameter in self.online.named_parameters()
            for key, value in self.optimiser.state.get(parameter, {}).items()
        }
        return {
            "online": self.online.state_dict(),
            "target": self.target.state_dict(),
            "moments": moments,
            "updates": self.updates,
        }

    @torch.no_grad()
    def set_state(self, state: dict[str, Any]) -> None:
        """Restores what `get_state` returned."""
        for network, saved in ((self.online, state["online"]), (self.target, state["target"])):
            network.load_state_dict({name: torch.as_tensor(value) for name, value in saved.items()})
        self.updates = state["updates"]
        self.optimiser.state.clear()
        if self.updates == 0:
            return  # Adam makes its moments in the first update
        for name, parameter in self.online.named_parameters():
            if not parameter.requires_grad:
                continue
            step, *moments = (
                torch.as_tensor(state["moments"][f"{name}.{key}"])
                for key in ("step", "exp_avg", "exp_avg_sq")
            )
            # the moments in the weights' own memory layout, on which the fused step relies
            first, second = (torch.empty_like(parameter).copy_(moment) for moment in moments)
            self.optimiser.state[parameter] = {
                "step": step.to(parameter.device, copy=True),
                "exp_avg": first,
                "exp_avg_sq": second,
            }


@torch.no_grad()
def transfer(weights: dict[str, Tensor], network: nn.Module, layers: str) -> None:
    """Copies a trained network's `weights` into another of the same kind.

    `layers`: "convolutions", or "all" but the output layers, which stay as they are, since games
    differ in their actions. Raises ParameterError if a weight is missing or has another shape.
    """
    for name, own in network.named_parameters():
        if name.startswith("convolutions") or (layers == "all" and "output" not in name):
            if name not in weights or weights[name].shape != own.shape:
                shape = tuple(own.shape)
                raise ParameterError(
                    f"initial_weights: the model to start from has no {name} of shape {shape}"
                )
            own.copy_(weights[name])


def learning_rate(params: Parameters, games_finished: int) -> float:
    """Step size of Adam: rises linearly over the first `warmup_games`, then stays."""
    if games_finished >= params.warmup_games:
        return params.learning_rate
    share = games_finished / params.warmup_games
    return params.warmup_learning_rate * (1 - share) + params.learning_rate * share


def torch_device(name: str) -> torch.device:
    """`auto` is the GPU where there is one. Raises ParameterError if there is none to be had."""
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise ParameterError(
            "device: 'cuda' is not allowed: PyTorch finds no GPU here; auto and cpu work"
        )
    return torch.device(name)
