"""Requests answered: foretold, answered, remembered, explained."""

import pytest

import lightstage
from lightstage.api.answers import Outlook, Why, answer, outlook, status, why
from lightstage.api.requests import make_request
from lightstage.dag.explain import Reason

NODES = ("register", "split", "stack", "align", "normals")


def test_what_is_foretold_is_what_comes(ball: lightstage.OpenSession) -> None:
    """Seven pictures, then one set of them; what lies below is not sure before its inputs are there."""
    request = make_request("ball", ["normals"])
    store = ball.opened
    before = outlook(request, store)
    assert list(before)[-5:] == list(NODES)
    assert before["register"] == Outlook(compute=7, check=0, reuse=0)
    assert [before[node] for node in NODES[1:]] == [Outlook(0, n, 0) for n in (7, 7, 1, 1)]
    computed = answer(request, store)
    assert {name: node.computed for name, node in computed.nodes.items()} == dict(
        zip(NODES, (7, 7, 7, 1, 1), strict=True)
    )
    assert [outlook(request, store)[node] for node in NODES] == [Outlook(0, 0, n) for n in (7, 7, 7, 1, 1)]
    again = answer(request, store)
    assert again.seconds == 0
    assert {node.computed for node in again.nodes.values()} == {0}
    assert {name: node.path for name, node in again.nodes.items()} == {
        name: node.path for name, node in computed.nodes.items()
    }


def test_a_preview_leaves_the_rest_to_be_done(ball: lightstage.OpenSession) -> None:
    answer(make_request("ball", ["split"], frames=(0, 3)), ball.opened)
    assert outlook(make_request("ball", ["split"]), ball.opened)["register"] == Outlook(4, 0, 3)
    states = status(make_request("ball", ["split"]), ball.opened)
    assert (states["split"].condition, states["split"].known, states["split"].blocks) == ("partial", 3, 7)


def test_why_names_what_changed_and_where(finished: lightstage.OpenSession) -> None:
    changed = why(make_request("ball", ["normals"], changes={"normals.method": "ratio"}), finished.opened)
    (reason,) = [reason for reason in changed.reasons if "method" in reason.what]
    assert (reason.node, reason.new) == ("normals", "ratio")
    assert str(changed).splitlines()[0] == changed.summary
    assert str(Why("because", (Reason("a", "b", "1", "2"),))) == "because\n  a, b: 1 -> 2"


def test_a_node_without_results_has_no_reasons(finished: lightstage.OpenSession) -> None:
    for name, hint in (("capture", ""), ("normls", "; did you mean 'normals'")):
        with pytest.raises(lightstage.RequestError, match=f"no (result of a )?node '{name}'{hint}"):
            why(make_request("ball", [name]), finished.opened)
