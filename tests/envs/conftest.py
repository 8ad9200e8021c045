"""What tests of several files use."""

import pytest

from bnprl_envs.model_files import read_model


@pytest.fixture
def read(tmp_path):
    def read_text(text, name="model.pomdp"):
        path = tmp_path / name
        path.write_text(text)
        return read_model(path)

    return read_text
