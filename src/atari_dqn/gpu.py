"""Learning on a GPU: the update of `agents.Learner`, recorded once and replayed as a CUDA graph,
and a replay memory whose images lie on the GPU.

A batch then travels as the numbers of its slots, Python launches one graph for an update instead of
its many small kernels one by one, and does not wait for it: the emulators play meanwhile.
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.grad import conv2d_input

from atari_dqn.agents import Learner
from atari_dqn.envs import SIZE
from atari_dqn.params import Parameters
from atari_dqn.replay import PIXELS, Batch, Drawn, ImageCodec, ImageStore, ReplayMemory

WARM_UP = 3  # updates before the recording, as PyTorch's documentation of graphs asks for
CHUNK = 4096  # images that are compressed or decompressed at a time


def new_memory(
    params: Parameters, seed: np.random.SeedSequence, device: torch.device
) -> ReplayMemory:
    """A run's replay memory: on the GPU if the networks are there, else compressed."""
    given = (
        params.replay_capacity,
        params.environments,
        params.frame_stack,
        params.gamma,
        seed,
        params.n_steps,
    )
    return ReplayMemory(*given) if device.type == "cpu" else GPUReplayMemory(*given, device=device)


class GPUReplayMemory(ReplayMemory):
    """A replay memory whose images lie on a GPU, a byte per pixel. `given` is what a `ReplayMemory`
    is given; the state is that of one with the same contents."""

    def __init__(self, *given: Any, device: torch.device):
        super().__init__(*given)
        # one row of streams after the other, as slots are numbered
        slots = self.rows * self.streams
        self.images = torch.zeros((slots, PIXELS), dtype=torch.uint8, device=device)

    def sample(self, count: int) -> "GPUBatch":  # type: ignore[override]
        return GPUBatch(self.images, self.draw(count))

    def _store(self, images: np.ndarray) -> None:
        if self.codec is None:  # of the state; here nothing is compressed
            self.codec = ImageCodec(images[0].tobytes())
        first = self.row * self.streams
        self.images[first : first + self.streams].copy_(torch.from_numpy(images))

    def get_state(self) -> dict[str, Any]:
        assert self.codec is not None
        for slots in self._chunks():
            for slot, image in zip(slots.tolist(), self.images[slots].cpu().numpy(), strict=True):
                self.frames[slot] = self.codec.compress(image)
        state = super().get_state()
        self.frames = ImageStore(self.rows * self.streams)
        return state

    def set_state(self, state: dict[str, Any]) -> None:
        super().set_state(state)
        for slots in self._chunks():
            images = self._images(slots.cpu().numpy()).copy()
            self.images[slots] = torch.from_numpy(images).to(self.images.device)
        self.frames = ImageStore(self.rows * self.streams)

    def _chunks(self) -> tuple[Tensor, ...]:
        """The written slots, oldest first, int64, in parts."""
        return torch.from_numpy(self._oldest_first()).to(self.images.device).split(CHUNK)


@dataclass(frozen=True)
class GPUBatch:
    """Transitions whose images lie on the GPU."""

    images: Tensor  # uint8 [slots, 84*84]
    drawn: Drawn


class _Convolve(torch.autograd.Function):
    """A convolution whose weights' gradient is one product of matrices: of cuDNN's kernels for it,
    those that give the same bits every time take as long as the rest of an update's backward
    pass."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor, stride: int) -> Tensor:
        ctx.save_for_backward(x, weight)
        ctx.stride = stride
        return nn.functional.conv2d(x, weight, bias, stride)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, Tensor, Tensor, None]:  # type: ignore[override]
        x, weight = ctx.saved_tensors  # [N, C, H, W], [O, C, K, K]
        side, stride = weight.shape[-1], ctx.stride
        patches = x.unfold(2, side, stride).unfold(3, side, stride)  # [N, C, h, w, K, K]
        patches = patches.permute(0, 2, 3, 4, 5, 1).flatten(0, 2).flatten(1)  # [N*h*w, K*K*C]
        outputs = gradient.permute(0, 2, 3, 1).flatten(0, 2)  # [N*h*w, O]
        to_weight = (outputs.T @ patches).unflatten(1, (side, side, -1)).permute(0, 3, 1, 2)
        to_x = None
        if ctx.needs_input_grad[0]:
            to_x = conv2d_input(x.shape, weight, gradient, stride)
        return to_x, to_weight, outputs.sum(0), None


class _Convolution(nn.Conv2d):
    def forward(self, x: Tensor) -> Tensor:
        return _Convolve.apply(x, self.weight, self.bias, self.stride[0])


class GraphLearner(Learner):
    """`agents.Learner` on a GPU: the same update, replayed as a CUDA graph. `given` is what a
    `Learner` is given."""

    def __init__(self, *given: Any):
        torch.backends.cudnn.allow_tf32 = False  # it keeps 10 of a product's 23 bits
        torch.backends.cudnn.deterministic = True  # a run can be repeated
        super().__init__(*given)
        for layer in self.online.modules():
            if isinstance(layer, nn.Conv2d):
                layer.__class__ = _Convolution
        self.acting: _Graph | None = None
        self.learning: _Graph | None = None

    @torch.no_grad()
    def q_values(self, observations: np.ndarray) -> np.ndarray:
        if len(observations) != self.params.environments:
            return super().q_values(observations)
        if self.acting is None:
            self.acting = _Graph(self.online, [self._tensor(observations)])
        return self.acting(torch.from_numpy(observations)).cpu().numpy()

    def learn(self, batch: GPUBatch) -> Tensor:  # type: ignore[override]
        """Returns loss and Q(s_tm1, a_tm1) as a tensor [2] on the GPU, which is not waited for."""
        inputs = [torch.from_numpy(array) for array in vars(batch.drawn).values()]
        if self.learning is None:
            self.learning = self._recorded(batch.images, inputs)
        loss_and_q = self.learning(*inputs).clone()  # the next update overwrites its own
        self._count_update()
        return loss_and_q

    def set_state(self, state: dict[str, Any]) -> None:
        super().set_state(state)
        self.acting = self.learning = None  # the optimiser's moments lie elsewhere now

    def _recorded(self, images: Tensor, inputs: list[Tensor]) -> "_Graph":
        def update(slots: Tensor, a_tm1: Tensor, r_t: Tensor, discount_t: Tensor) -> Tensor:
            stacks = images[slots].unflatten(-1, (SIZE, SIZE)).permute(1, 2, 3, 0)
            stack = self.params.frame_stack
            s_tm1, s_t = stacks[..., :stack], stacks[..., -stack:]  # [N, 84, 84, S]
            batch = Batch(s_tm1, a_tm1, r_t, discount_t, s_t)  # type: ignore[arg-type]
            return torch.stack(self._update(batch))

        before = deepcopy(self.get_state())
        return _Graph(update, [each.to(self.device) for each in inputs], lambda: self._undo(before))

    @torch.no_grad()
    def _undo(self, before: dict[str, Any]) -> None:
        """Takes weights and moments back, in place, to an earlier state."""
        self.online.load_state_dict(before["online"])
        for name, parameter in self.online.named_parameters():
            for key, value in self.optimiser.state.get(parameter, {}).items():
                value.copy_(before["moments"].get(f"{name}.{key}", torch.zeros(())))


class _Graph:
    """A function of tensors, recorded. It is called a few times first, as PyTorch's documentation
    of CUDA graphs asks for, and `undo` then undoes what these calls have changed."""

    def __init__(
        self,
        function: Callable[..., Tensor],
        inputs: list[Tensor],
        undo: Callable[[], None] = lambda: None,
    ):
        self.inputs = [each.clone() for each in inputs]
        aside = torch.cuda.Stream()
        aside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(aside):
            for _ in range(WARM_UP):
                function(*self.inputs)
        torch.cuda.current_stream().wait_stream(aside)
        undo()
        self.graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(self.graph):
            self.output = function(*self.inputs)

    def __call__(self, *inputs: Tensor) -> Tensor:
        for own, given in zip(self.inputs, inputs, strict=True):
            own.copy_(given, non_blocking=True)
        self.graph.replay()
        return self.output
