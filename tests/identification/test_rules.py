from dataclasses import FrozenInstanceError, fields

import pytest
import rules_page

from dehyst.identification.rules import RULES, DecisionRules


def test_the_page_of_the_rules_is_their_class():
    assert rules_page.PAGE.read_text() == rules_page.page()


def test_each_rule_has_a_unit_and_a_reason():
    assert all(rule.metadata["unit"] and rule.metadata["reason"].endswith(".") for rule in fields(DecisionRules))
    with pytest.raises(FrozenInstanceError):
        RULES.part_gain = 1.0
