"""The only door to the compiled steppers of Preisach, Bouc-Wen and Duhem. Equations: `core/baselines/fields.h`."""

from __future__ import annotations

from dehyst._rivals import bouc_wen, coleman_hodgdon, cubic, preisach, preisach_weights

__all__ = ["bouc_wen", "coleman_hodgdon", "cubic", "preisach", "preisach_weights"]
