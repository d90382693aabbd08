"""Networks that are fields."""

from levelflow.networks.lifting import lift
from levelflow.networks.siren import SIREN

__all__ = ["SIREN", "lift"]
