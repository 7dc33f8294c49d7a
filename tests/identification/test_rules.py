from dataclasses import FrozenInstanceError, fields

import pytest

from dehyst.identification.rules import RULES, DecisionRules


def test_each_rule_has_a_unit_and_a_reason():
    assert all(rule.metadata["unit"] and rule.metadata["reason"].endswith(".") for rule in fields(DecisionRules))
    with pytest.raises(FrozenInstanceError):
        RULES.part_gain = 1.0
