"""What one document has that another has not."""

from __future__ import annotations

import pytest

from orbisim.errors import SceneError
from orbisim.scene.patch.differences import Change, Insertion, differences, matched
from orbisim.scene.patch.marked import parsed

OLD = """<worldbody><body name="a"><joint name="j" damping="1"/><geom/><geom size="2"/></body>
</worldbody>"""


def test_changes_and_insertions() -> None:
    new = OLD.replace('damping="1"', 'damping="2" armature="3"').replace(
        "<geom/>", '<joint name="k"/><geom/>'
    )
    found = list(differences(parsed(OLD), parsed(new)))
    changes = [one for one in found if isinstance(one, Change)]
    assert [dict(one.attributes) for one in changes] == [{"damping": "2", "armature": "3"}]
    (insertion,) = (one for one in found if isinstance(one, Insertion))
    assert insertion.element.name == "k"
    assert insertion.previous is not None and insertion.previous.name == "j"
    assert not list(differences(parsed(OLD), parsed(OLD)))


def test_what_is_gone_is_refused() -> None:
    with pytest.raises(SceneError, match="1 elements in <body> are no longer there"):
        list(differences(parsed(OLD), parsed(OLD.replace("<geom/>", ""))))
    removed = dict(next(iter(_changes(OLD, OLD.replace(' size="2"', "")))).attributes)
    assert removed == {"size": None}


def _changes(old: str, new: str) -> list[Change]:
    return [one for one in differences(parsed(old), parsed(new)) if isinstance(one, Change)]


def test_actuators_are_told_apart_by_their_names_alone() -> None:
    first = parsed("<actuator><motor name='a'/><position name='b'/></actuator>").children
    second = parsed("<actuator><general name='b'/><general name='a'/></actuator>").children
    pairs = matched(first, second, "actuator")
    assert [(one.name, other.name) for one, other in pairs] == [("a", "a"), ("b", "b")]
    assert not matched(first, second, "body")
