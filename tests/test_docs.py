"""What the documents say is what the program does."""

import contextlib
import io
import re
import subprocess
from pathlib import Path

import pytest
from mcap.reader import make_reader

from rangecam.cli import main
from rangecam.config import preset_names
from rangecam.scene.scenario import scenario_names

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
DOCUMENTS = [
    ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/errata.md")
]


def test_the_python_of_the_readme_runs_and_ends_with_a_brake() -> None:
    (block,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert len([line for line in block.splitlines() if line.strip()]) <= 12
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(compile(block, "README.md", "exec"), {})
    assert "stopping needs" in out.getvalue().splitlines()[-1]


def test_a_recording_can_be_read_as_its_description_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "docs" / "recordings.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert main(["run", "scenario:test-scene", "--record", "recording.mcap", "--set", "camera.rows=12"]) == 0
    with open("recording.mcap", "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    for channel in summary.channels.values():
        topic = re.sub(r"^/(raw|truth)/.*", r"/\1/PLANE", channel.topic)
        assert f"`{topic}`" in text
        assert f"`{summary.schemas[channel.schema_id].name}`" in text
    (block,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(compile(block, "recordings.md", "exec"), {})
    assert len(out.getvalue().splitlines()) == 60


def test_the_two_commands_of_the_readme_are_one_line_each_and_set_up_everything() -> None:
    commands = [line for line in README.splitlines() if line.startswith("python3 -m venv")]
    assert len(commands) == 2
    assert commands[0].endswith("rangecam demo")
    assert "[test]" in commands[1]
    assert all(part in commands[1] for part in ("ruff check", "ruff format --check", "mypy", "pytest"))


def test_continuous_integration_runs_the_command_of_the_readme() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    (finds,) = re.findall(r"^command=\$\((.*)\)$", script, flags=re.MULTILINE)
    found = subprocess.run(["bash", "-c", finds], cwd=ROOT, capture_output=True, text=True, check=True)
    assert found.stdout.splitlines() == [line for line in README.splitlines() if "[test]" in line and "venv" in line]


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda p: p.name)
def test_every_link_leads_to_a_file(path: Path) -> None:
    links = re.findall(r"\]\(([^)#]+)\)", path.read_text(encoding="utf-8"))
    missing = [link for link in links if "://" not in link and not (path.parent / link).exists()]
    assert not missing


def test_every_module_stands_on_the_map() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    package = ROOT / "src" / "rangecam"
    names = {p.name for p in package.iterdir() if p.suffix == ".py" and not p.name.startswith("__")}
    folders = {f"{p.name}/" for p in package.iterdir() if (p / "__init__.py").exists()}
    assert not [name for name in names | folders if f"`{name}" not in text and f"{name}`" not in text]


def test_the_readme_names_presets_that_exist() -> None:
    named = re.search(r"Presets are.*?lists them all", README, flags=re.DOTALL)
    assert named
    assert {"scaled_car", "usercams", "generic_cw", "generic_pulsed", "generic_range", "vl53l5cx"} <= {*preset_names()}
    assert {word for word in re.findall(r"`(\w+)`", named.group()) if "_" in word} <= {*preset_names()}


def test_the_changelog_names_every_scenario() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in changelog for name in scenario_names())


def test_every_erratum_that_the_code_cites_is_listed() -> None:
    listed = set(re.findall(r"E-[KS]-\d+", (ROOT / "docs" / "errata.md").read_text(encoding="utf-8")))
    sources = (ROOT / "src").rglob("*.py")
    cited = {number for path in sources for number in re.findall(r"E-[KS]-\d+", path.read_text(encoding="utf-8"))}
    assert not cited - listed


def test_no_path_of_a_machine_stands_in_the_repository() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("not a checkout")
    files = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    pattern = re.compile(r"/(?:home|root|work|tmp|Users)/\w")
    text = {f: (ROOT / f).read_text(encoding="utf-8", errors="ignore") for f in files if (ROOT / f).is_file()}
    assert not [f for f, content in text.items() if pattern.search(content) and not f.endswith(".png")]
