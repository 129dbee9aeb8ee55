"""Functions as CUDA graphs, or as they are."""

from __future__ import annotations

import pytest
import torch
from orbisim_world_model.graphs import Graphed


def test_without_a_graph_it_is_the_function() -> None:
    calls = []
    graphed = Graphed(lambda: calls.append(1) or len(calls), lambda: calls.clear(), False)
    assert calls == []
    assert [graphed(), graphed()] == [1, 2]


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_a_graph_computes_the_same() -> None:
    values = torch.zeros(3, device="cuda")
    graphed = Graphed(lambda: values.add_(1.0), lambda: values.zero_(), True)
    assert values.tolist() == [0.0] * 3
    graphed()
    graphed()
    assert values.tolist() == [2.0] * 3
