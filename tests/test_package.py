"""The wheel, made from the source distribution, holds the packages and works where it is put."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.baselines.interruption import ROOT

PACKAGES = {"bnprl_envs", "bnprl_agents", "baselines"}


def run(*arguments: str, cwd: Path = ROOT, **environment: str) -> str:
    """Run Python; return what it printed."""
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the source distribution and of the wheel that was made from it."""
    folder = tmp_path_factory.mktemp("dist")
    run("-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT))
    return folder


def test_what_the_archives_hold(built: Path) -> None:
    (wheel,), (source,) = built.glob("*.whl"), built.glob("*.tar.gz")
    files = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in files if ".dist-info/" not in name} == PACKAGES
    assert {f"{package}/py.typed" for package in PACKAGES} <= set(files)
    assert "baselines/benchmarks/parcels.POMDP" in files
    assert not any(name.startswith("baselines/results/") for name in files)
    with tarfile.open(source) as archive:
        inside = {name.partition("/")[2] for name in archive.getnames()}
    assert {"README.md", "LICENSE", "tests/test_package.py", "examples/my_agent.py"} <= inside


def test_the_wheel_works_where_it_is_put(built: Path, tmp_path: Path) -> None:
    (wheel,) = built.glob("*.whl")
    site = tmp_path / "site"
    run("-m", "pip", "install", "-q", "--no-deps", "--target", str(site), str(wheel))
    where = run(
        "-c", "import baselines; print(baselines.__file__)", cwd=tmp_path, PYTHONPATH=str(site)
    )
    assert Path(where.strip()).is_relative_to(site)
    shown = run("-m", "baselines.cli", "list", "experiments", cwd=tmp_path, PYTHONPATH=str(site))
    assert "figure-3.2" in shown


def test_requirements_agree() -> None:
    run("-m", "pip", "check")
