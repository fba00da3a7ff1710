"""The two networks: pixels in, one value per action out.

Shapes in comments: B = batch, S = frame_stack, A = actions. Observations arrive as bytes with the
channels last, [B, 84, 84, S], and stay so in memory ("channels_last"): the fastest layout for
convolutions on a CPU, from the first layer to the flattening, which then copies nothing.
"""

import torch
from torch import Tensor, nn

FEATURES = 7 * 7 * 64  # what the convolutions make of 84x84 pixels


class Convolutions(nn.Sequential):
    """The feature extractor of Mnih et al. (2015), Methods, "Model architecture"."""

    def __init__(self, stack: int):
        super().__init__(
            nn.Conv2d(stack, 32, kernel_size=8, stride=4),  # [B, 32, 20, 20]
            nn.ReLU(inplace=True),
            nn.Conv2d(32, 64, kernel_size=4, stride=2),  # [B, 64, 9, 9]
            nn.ReLU(inplace=True),
            nn.Conv2d(64, 64, kernel_size=3, stride=1),  # [B, 64, 7, 7]
            nn.ReLU(inplace=True),
        )
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, observations: Tensor) -> Tensor:
        """Bytes [B, 84, 84, S] to features [B, 3136], ordered by row, column, channel."""
        x = observations.float().mul_(1 / 255).permute(0, 3, 1, 2)  # [B, S, 84, 84], a view
        return super().forward(x).permute(0, 2, 3, 1).flatten(1)  # a view again


class NatureNetwork(nn.Module):
    """Q-values of every action (Mnih et al., 2015)."""

    def __init__(self, stack: int, actions: int):
        super().__init__()
        self.convolutions = Convolutions(stack)
        self.hidden = nn.Linear(FEATURES, 512)
        self.output = nn.Linear(512, actions)

    def forward(self, observations: Tensor) -> Tensor:
        """Bytes [B, 84, 84, S] to Q(s, a), float32 [B, A]."""
        x = self.convolutions(observations)  # [B, 3136]
        x = torch.relu(self.hidden(x))  # [B, 512]
        return self.output(x)  # [B, A]


class DuelingNetwork(nn.Module):
    """Q(s, a) = V(s) + A(s, a) - mean A(s, .) (Wang et al., 2016, equation 9)."""

    def __init__(self, stack: int, actions: int):
        super().__init__()
        self.convolutions = Convolutions(stack)
        self.value_hidden = nn.Linear(FEATURES, 512)
        self.value_output = nn.Linear(512, 1)
        self.advantage_hidden = nn.Linear(FEATURES, 512)
        self.advantage_output = nn.Linear(512, actions)

    def forward(self, observations: Tensor) -> Tensor:
        """Bytes [B, 84, 84, S] to Q(s, a), float32 [B, A]."""
        x = self.convolutions(observations)  # [B, 3136]
        value = self.value_output(torch.relu(self.value_hidden(x)))  # [B, 1]
        advantage = self.advantage_output(torch.relu(self.advantage_hidden(x)))  # [B, A]
        return value + advantage - advantage.mean(dim=1, keepdim=True)  # [B, A]
