"""A layer of heat over a video: the pixels by which a network's values would change most.

The maps are those of Wang et al. (2016), figure 2: the slopes of the state's value, and of the
best action's advantage, along the brightness of every pixel of the newest image. One pass back
through the network gives one of them for the whole picture, where blurring it place by place
(saliency.py) takes hundreds of passes; but a slope tells only of a change that is too small to be
seen, of one pixel by itself.
"""

import cv2
import numpy as np
import torch
from torch import nn

SOFT = 1.5  # pixels, standard deviation: of the blur that joins neighbouring pixels
FULL = 0.999  # of all pixels of a video have less than the full colour
COLOURS = {"value": (255, 140, 0), "advantage": (0, 150, 255)}  # orange and blue: all can tell
SOME = 64  # observations that go through the network at once


def slopes(network: nn.Module, observations: np.ndarray) -> np.ndarray:
    """How much a network's values change with each pixel of the newest image: absolute values of
    derivatives, points per level of grey, float32 [N, 84, 84, 2], in observations uint8
    [N, 84, 84, S]. First those of the state's value, the mean over the actions as in
    `saliency.saliency`; then those of the best action's advantage over that."""
    device, found = next(network.parameters()).device, []
    for part in torch.from_numpy(observations).split(SOME):
        pixels = part.to(device).float().requires_grad_()
        values = network(pixels.clone())  # [n, A], of a copy, since it is scaled in place
        state = values.mean(dim=1)
        advantage = values.max(dim=1).values - state
        both = [
            torch.autograd.grad(each.sum(), pixels, retain_graph=True)[0][..., -1]
            for each in (state, advantage)
        ]
        found.append(torch.stack(both, dim=-1).abs().cpu())
    return torch.cat(found).numpy()


def light(network: nn.Module, observations: np.ndarray) -> np.ndarray:
    """The colours uint8 [N, 84, 84, 3] that lie over the pictures of a video, whose observations
    are uint8 [N, 84, 84, S]: black where nothing matters, and the two colours' light together
    where both maps are bright. Each map has one scale throughout, so that moments compare."""
    found = slopes(network, observations)
    maps = np.stack([cv2.GaussianBlur(each, (0, 0), SOFT) for each in found])
    full = np.quantile(maps, FULL, axis=(0, 1, 2))
    shares = np.clip(maps / np.maximum(full, 1e-12), 0, 1)  # [N, 84, 84, 2]
    value, advantage = (
        1 - shares[..., [kind]] * np.array(colour) / 255
        for kind, colour in enumerate(COLOURS.values())
    )
    return np.rint(255 * (1 - value * advantage)).astype(np.uint8)
