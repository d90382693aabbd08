"""Networks that are fields."""

from levelflow.networks.lifting import lift
from levelflow.networks.siren import SIREN, sliced

__all__ = ["SIREN", "lift", "sliced"]
