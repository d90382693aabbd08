"""Networks that are fields, and networks that move space."""

from levelflow.networks.invertible import Inverse, InvertibleResNet
from levelflow.networks.lifting import lift
from levelflow.networks.lipschitz import LipschitzMLP
from levelflow.networks.periodic import Periodic
from levelflow.networks.siren import SIREN, sliced

__all__ = ["SIREN", "Inverse", "InvertibleResNet", "LipschitzMLP", "Periodic", "lift", "sliced"]
