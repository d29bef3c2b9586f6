import numpy as np
import torch
from torch import nn

from pipeline.policies.optimiser import FlatAdamW, one_cycle


def test_flat_adamw_under_one_cycle_walks_where_pytorch_walks():
    ours, theirs = (nn.Sequential(nn.Linear(4, 6), nn.LayerNorm(6), nn.Linear(6, 2)) for _ in range(2))
    theirs.load_state_dict(ours.state_dict())
    flat = FlatAdamW(list(ours.parameters()))
    adamw = torch.optim.AdamW(theirs.parameters())
    cycle = torch.optim.lr_scheduler.OneCycleLR(adamw, 1e-2, total_steps=50, cycle_momentum=False)
    x, y = torch.randn(50, 8, 4), torch.randn(50, 8, 2)
    for k in range(50):
        assert np.isclose(one_cycle(k, 50, 1e-2), cycle.get_last_lr()[0], rtol=1e-9)
        (ours(x[k]) - y[k]).square().mean().backward()
        flat.step(k, one_cycle(k, 50, 1e-2))
        adamw.zero_grad()
        (theirs(x[k]) - y[k]).square().mean().backward()
        adamw.step()
        cycle.step()
    for a, b in zip(ours.parameters(), theirs.parameters(), strict=True):
        assert torch.allclose(a, b, atol=1e-5)
