import torch
from torch import nn

from levelflow.optimising import SOAP


def solved(optimiser, *, steps=400, matrix=True):
    """How far an ill-conditioned least-squares problem, min |A W B - Y|^2, is from its solution."""
    generator = torch.Generator().manual_seed(3)

    def spread(n):
        basis = torch.linalg.qr(torch.randn(n, n, generator=generator, dtype=torch.float64))[0]
        return basis @ torch.diag(torch.logspace(0, -1.5, n, dtype=torch.float64)) @ basis.T

    a, b = spread(6), spread(4)
    goal = torch.randn(6, 4, generator=generator, dtype=torch.float64)
    weight = nn.Parameter(torch.zeros(6, 4, dtype=torch.float64) if matrix else torch.zeros(24, dtype=torch.float64))
    descent = optimiser([weight])
    for step in range(steps):
        for group in descent.param_groups:
            group["lr"] = 0.1 * (1 - step / steps)
        descent.zero_grad()
        ((a @ (weight.reshape(6, 4) - goal) @ b) ** 2).sum().backward()
        descent.step()
    return float((weight.detach().reshape(6, 4) - goal).norm() / goal.norm())


def test_it_solves_what_is_ill_conditioned_along_oblique_axes_better_than_adam():
    assert solved(SOAP) < 0.3 * solved(lambda p: torch.optim.Adam(p, lr=0.1, betas=(0.95, 0.95)))


def test_a_vector_gets_the_steps_of_adam():
    betas = (0.95, 0.95)
    mine = solved(lambda p: SOAP(p, lr=0.1, betas=betas), matrix=False, steps=50)
    adam = solved(lambda p: torch.optim.Adam(p, lr=0.1, betas=betas), matrix=False, steps=50)
    assert abs(mine - adam) < 1e-6


def test_the_bases_are_orthogonal_and_diagonalise_the_means():
    generator = torch.Generator().manual_seed(0)
    weight = nn.Parameter(torch.zeros(5, 3, dtype=torch.float64))
    descent = SOAP([weight], lr=0.0, every=1)
    shape = torch.randn(5, 3, generator=generator, dtype=torch.float64)
    for _ in range(200):
        weight.grad = shape * torch.randn(5, 1, generator=generator, dtype=torch.float64)
        descent.step()
    state = descent.state[weight]
    for side in ("left", "right"):
        basis = state[f"{side}_basis"]
        turned = basis.T @ state[side] @ basis
        assert torch.allclose(basis.T @ basis, torch.eye(len(basis), dtype=torch.float64), atol=1e-12)
        assert (turned - torch.diag(turned.diagonal())).norm() < 0.2 * turned.norm()
