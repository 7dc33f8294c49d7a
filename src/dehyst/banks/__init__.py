"""Many actuators at once, such as those of a deformable mirror: one call steps or runs all of them."""

from dehyst.banks.bank import Bank
from dehyst.banks.state import BankClamps, BankState

__all__ = ["Bank", "BankClamps", "BankState"]
