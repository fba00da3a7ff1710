"""The three agents. Each is a network and a target, towards which Q(s_tm1, a_tm1) is moved:

    dqn                 NatureNetwork    r + gamma max_a Q_target(s', a)
    double_dqn          NatureNetwork    r + gamma Q_target(s', argmax_a Q_online(s', a))
    dueling_double_dqn  DuelingNetwork   r + gamma Q_target(s', argmax_a Q_online(s', a))

Everything else, one gradient step on (target - Q_online(s, a))^2, they share. This is the reference
for the learner in C++ (`native`), which trains where it can. Names carry time as in dqn_zoo:
s_tm1, a_tm1 -> r_t, s_t.
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from atari_dqn.networks import DuelingNetwork, NatureNetwork
from atari_dqn.params import ParameterError, Parameters
from atari_dqn.replay import Batch


def q_learning(batch: Batch, online: nn.Module, target_network: nn.Module) -> Tensor:
    """Targets [B] of DQN (Mnih et al., 2015, algorithm 1)."""
    q_t = target_network(batch.s_t)  # [B, A]
    return batch.r_t + batch.discount_t * q_t.max(dim=1).values


def double_q_learning(batch: Batch, online: nn.Module, target_network: nn.Module) -> Tensor:
    """Targets [B] of Double DQN: the online network selects, the target network evaluates
    (van Hasselt et al., 2016, section "Double DQN")."""
    a_t = online(batch.s_t).argmax(dim=1, keepdim=True)  # [B, 1]
    q_t = target_network(batch.s_t)  # [B, A]
    return batch.r_t + batch.discount_t * q_t.gather(1, a_t).squeeze(1)


@dataclass(frozen=True)
class Agent:
    """What sets one agent apart from another."""

    network: type[nn.Module]
    target: Callable[[Batch, nn.Module, nn.Module], Tensor]


AGENTS = {
    "dqn": Agent(NatureNetwork, q_learning),
    "double_dqn": Agent(NatureNetwork, double_q_learning),
    "dueling_double_dqn": Agent(DuelingNetwork, double_q_learning),
}


class Learner:
    """The online network, its target network and the optimiser."""

    kind = "torch"

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
        self.online = initial_network(agent, actions, params, seed, initial).to(self.device)
        self.online.convolutions.requires_grad_(not params.freeze_convolutions)
        self.target = deepcopy(self.online).requires_grad_(False)
        learned = [weight for weight in self.online.parameters() if weight.requires_grad]
        on_gpu = self.device.type == "cuda"
        self.optimiser = torch.optim.Adam(
            learned,
            # a tensor, so that a recorded update reads it anew (`gpu`)
            lr=torch.tensor(params.learning_rate, device=self.device)
            if on_gpu
            else params.learning_rate,
            eps=params.adam_epsilon,
            fused=True,
            capturable=on_gpu,
        )
        self.updates = 0

    @torch.no_grad()
    def q_values(self, observations: np.ndarray) -> np.ndarray:
        """Bytes [N, 84, 84, S] to Q-values float32 [N, A]."""
        return self.online(self._tensor(observations)).cpu().numpy()

    def learn(self, batch: Batch) -> tuple[float, float]:
        """Makes one gradient step, and updates the target network if that is due.

        Returns the batch's mean loss and mean Q(s_tm1, a_tm1).
        """
        batch = Batch(**{name: self._tensor(array) for name, array in vars(batch).items()})
        loss, q = self._update(batch)
        self._count_update()
        return loss.item(), q.item()

    def _update(self, batch: Batch) -> tuple[Tensor, Tensor]:
        with torch.no_grad():
            target = self.agent.target(batch, self.online, self.target)  # [B]
        q_tm1 = self.online(batch.s_tm1)  # [B, A]
        q_a_tm1 = q_tm1.gather(1, batch.a_tm1[:, None]).squeeze(1)  # [B]
        loss = nn.functional.mse_loss(q_a_tm1, target)
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        return loss.detach(), q_a_tm1.detach().mean()

    def _count_update(self) -> None:
        self.updates += 1
        if self.updates % self.params.target_update_period == 0:
            self._update_target()

    def set_learning_rate(self, rate: float) -> None:
        for group in self.optimiser.param_groups:
            if isinstance(group["lr"], Tensor):
                group["lr"].fill_(rate)
            else:
                group["lr"] = rate

    @torch.no_grad()
    def _update_target(self) -> None:
        """Moves the target weights by the share `tau` towards the online ones; 1 copies them."""
        for theta_minus, theta in zip(
            self.target.parameters(), self.online.parameters(), strict=True
        ):
            theta_minus.lerp_(theta, self.params.tau)

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array).to(self.device)

    def weights(self) -> dict[str, Tensor]:
        """The online network's, as copies, which further updates leave alone."""
        return {name: weight.clone() for name, weight in self.online.state_dict().items()}

    def set_weights(self, weights: dict[str, Tensor]) -> None:
        """Replaces the online network's."""
        self.online.load_state_dict(weights)

    def get_state(self) -> dict[str, Any]:
        """Weights, the optimiser's moments and counters; every value a tensor or a number."""
        moments = {
            f"{name}.{key}": value
            for name, parameter in self.online.named_parameters()
            for key, value in self.optimiser.state.get(parameter, {}).items()
        }
        return {
            "online": self.weights(),
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


def initial_network(
    agent: Agent,
    actions: int,
    params: Parameters,
    seed: int,
    initial: dict[str, Tensor] | None = None,
) -> nn.Module:
    """The network that training starts from: PyTorch's random weights and, where `initial` has
    any to transfer, those."""
    with torch.random.fork_rng():  # nothing but the initial weights is drawn from torch
        torch.manual_seed(seed)
        network = agent.network(params.frame_stack, actions)
    if initial is not None:
        transfer(initial, network, params.transferred_layers)
    return network


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


def torch_device(name: str) -> torch.device:
    """`auto` is the GPU where there is one. Raises ParameterError if there is none to be had."""
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise ParameterError(
            "device: 'cuda' is not allowed: PyTorch finds no GPU here; auto and cpu work"
        )
    return torch.device(name)
