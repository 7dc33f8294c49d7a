"""The public interface is the one that is listed: names, signatures and options."""

import public_api


def test_the_public_interface_is_the_listed_one():
    """A change that is meant is listed by `python tests/support/public_api.py`, and has a fragment in changelog.d."""
    listed = public_api.LISTED.read_text(encoding="utf-8").splitlines()
    found = public_api.lines()
    assert [line for line in listed if line not in found] == [], "gone or changed"
    assert [line for line in found if line not in listed] == [], "new"
