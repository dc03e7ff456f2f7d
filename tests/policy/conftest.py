"""An arm as an environment, and a network that it is read through."""

import pytest

from policy.residual_cases import SHIFT, XML, shifting


@pytest.fixture
def xml(tmp_path):
    (tmp_path / "arm.xml").write_text(XML)
    return tmp_path / "arm.xml"


@pytest.fixture
def network(tmp_path):
    return shifting(tmp_path / "network", SHIFT)
