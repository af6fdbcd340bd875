"""What deploy/ says is what the product understands; what cannot run here is whole, locked down and consistent."""

import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import zipfile
from fnmatch import fnmatchcase as fnmatch
from pathlib import Path

import pytest
import yaml

from service.config import PREFIX, Settings, load
from tests.support.commands_of import assert_understood

ROOT = Path(__file__).parents[3]
DEPLOY = ROOT / "deploy"
UNITS = sorted((DEPLOY / "systemd").glob("*.service")) + sorted((DEPLOY / "systemd").glob("*.timer"))
SERVICES = [unit for unit in UNITS if unit.suffix == ".service"]
OTHER_VARIABLES = {"AMBIT_CONFIG", "AMBIT_DB_PASSWORD", "AMBIT_KEY", "AMBIT_URL", "AMBIT_CA"}


def known_variables() -> set[str]:
    return {PREFIX + name.upper() for name in Settings.model_fields} | OTHER_VARIABLES


# ---- settings


def test_the_example_configuration_is_the_defaults(tmp_path):
    assert load(DEPLOY / "ambit.toml", environment={}) == load(None, environment={})


def test_the_example_configuration_names_every_setting():
    text = (DEPLOY / "ambit.toml").read_text()
    assert set(re.findall(r"^#? ?(\w+) = ", text, re.MULTILINE)) == set(Settings.model_fields)
    tomllib.loads(re.sub(r"^# (\w+ = )", r"\1", text, flags=re.MULTILINE))


@pytest.mark.parametrize("path", sorted(p for p in DEPLOY.rglob("*") if p.is_file()), ids=lambda p: p.name)
def test_no_file_names_a_variable_that_nobody_reads(path):
    assert set(re.findall(r"\bAMBIT_[A-Z_]+\b", path.read_text())) <= known_variables()


# ---- commands


def readme_commands() -> list[str]:
    text = (DEPLOY / "README.md").read_text()
    code = re.findall(r"```sh\n(.*?)```", text, re.DOTALL) + re.findall(r"`([^`\n]*(?:\n[^`\n]+)?)`", text)
    lines = [line.strip() for block in code for line in re.split(r"[\n;]", block)]
    return [
        line.split("#")[0].strip()
        for line in lines
        if re.search(r"(^|/|api |exec api )ambit (db|keys|serve|worker)", line)
    ]


@pytest.mark.parametrize("line", sorted(set(readme_commands())))
def test_every_command_of_the_readme_is_understood(line):
    words = shlex.split(line)
    at = next(k for k, word in enumerate(words) if word == "ambit" or word.endswith("/ambit"))
    assert_understood(words[at + 1 :])


def test_the_readme_shows_backup_restore_upgrade_and_keys():
    shown = " ".join(readme_commands())
    for command in ("db backup", "db restore", "db upgrade", "keys create", "keys revoke"):
        assert command in shown


# ---- systemd


@pytest.mark.parametrize("unit", SERVICES, ids=lambda p: p.name)
def test_a_unit_runs_a_command_that_is_understood(unit):
    (line,) = re.findall(r"^ExecStart=(.+)$", unit.read_text(), re.MULTILINE)
    program, *arguments = shlex.split(line)
    assert program == "/opt/ambit/bin/ambit"
    assert_understood(arguments)


def installed(folder: Path) -> list[str]:
    """The units in a folder, with a program that exists here, and instances in place of templates."""
    names = []
    for unit in UNITS:
        text = unit.read_text().replace("/opt/ambit/bin/ambit", sys.executable).replace("User=ambit", "User=root")
        text = text.replace("Group=ambit", "Group=root").replace("ReadWritePaths=/var", "ReadWritePaths=-/var")
        text = re.sub(r"^Documentation=.*\n", "", text, flags=re.MULTILINE)
        (folder / unit.name).write_text(text)
        names.append(str(folder / unit.name.replace("@", "@1")))
    return names


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_systemd_finds_no_fault_in_the_units(tmp_path):
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", *installed(tmp_path)], capture_output=True, text=True, check=False
    )
    told = [line for line in done.stderr.splitlines() if str(tmp_path) in line or "ambit" in line]
    assert not told
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
@pytest.mark.parametrize("unit", SERVICES, ids=lambda p: p.name)
def test_a_unit_is_locked_down(unit):
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--threshold=30", str(unit)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if "offline" in done.stderr:
        pytest.skip("this systemd-analyze cannot look at a file")
    assert done.returncode == 0, done.stdout[-1500:] + done.stderr


NUMBERED = {"ttyS": 4, "ttyACM": 166, "ttyUSB": 188, "ttyAMA": 204, "ttymxc": 207, "rfcomm": 216}
"""Of the kernel's Documentation/admin-guide/devices.txt, and of its drivers."""
UNNUMBERED = ("ttyO", "ttyPS", "ttyLP", "ttySTM", "ttyTHS", "ttyMSM", "ttyXRUSB", "ttyMXUSB")
"""Names that the kernel gives the next number that is free."""
NO_SERIAL_PORT = ("/dev/tty", "tty", "ptm", "pts", "mem", "input", "hidraw", "watchdog")


def allowed(unit: Path, name: str, number: int | None = None) -> bool:
    """Whether a unit may open such a device, as systemd looks for it: by number, or by name in /proc/devices."""
    found = re.findall(r"^DeviceAllow=char-(\S+) rw$", unit.read_text(), re.MULTILINE)
    return any(str(number) == word if word.isdigit() else number is None and fnmatch(name, word) for word in found)


MEASURING = [unit for unit in SERVICES if "DevicePolicy=closed" in unit.read_text()]


@pytest.mark.parametrize("unit", MEASURING, ids=lambda p: p.name)
@pytest.mark.parametrize(("name", "number"), NUMBERED.items())
def test_a_serial_adapter_may_be_plugged_in_after_the_unit_has_started(unit, name, number):
    """systemd looks a device's name up in /proc/devices, which has ttyUSB only once such an adapter has been there."""
    assert allowed(unit, name, number)


@pytest.mark.parametrize("unit", MEASURING, ids=lambda p: p.name)
def test_serial_ports_of_gateways_may_be_opened_and_nothing_else(unit):
    assert [name for name in UNNUMBERED if not allowed(unit, name)] == []
    assert [name for name in NO_SERIAL_PORT if allowed(unit, name)] == []
    assert len(re.findall("^DeviceAllow=", unit.read_text(), re.MULTILINE)) == len(NUMBERED) + 1


def test_only_what_talks_to_controllers_has_serial_ports():
    assert {unit.name for unit in MEASURING} == {"ambit.service", "ambit-api.service", "ambit-worker@.service"}
    for unit in SERVICES:
        assert ("DeviceAllow=" in unit.read_text()) is (unit in MEASURING)


# ---- compose


@pytest.fixture(scope="module")
def compose() -> dict:
    return yaml.safe_load((DEPLOY / "compose.yaml").read_text())


def ours(compose: dict) -> dict[str, dict]:
    return {name: s for name, s in compose["services"].items() if s["image"] == "ambit"}


def test_the_parts_are_there(compose):
    assert set(compose["services"]) == {"api", "worker1", "worker2", "rig", "postgres"}
    assert len(ours(compose)) == 4


def test_containers_are_locked_down(compose):
    for name, service in ours(compose).items():
        assert service["user"].split(":")[0] not in ("0", "root", ""), name
        assert service["read_only"] is True, name
        assert service["cap_drop"] == ["ALL"], name
        assert "no-new-privileges:true" in service["security_opt"], name
        assert not service.get("privileged"), name
        assert any(v.endswith(":/var/lib/ambit") for v in service["volumes"]), name
        assert any(t.startswith("/tmp") for t in service["tmpfs"]), name
    for name, service in compose["services"].items():
        for port in service.get("ports", []):
            assert port.startswith("127.0.0.1:"), name


def test_commands_of_containers_are_understood(compose):
    for service in ours(compose).values():
        assert_understood(service["command"])


def test_what_containers_wait_for_and_mount_is_there(compose):
    for service in compose["services"].values():
        for other, how in service.get("depends_on", {}).items():
            assert other in compose["services"]
            if how["condition"] == "service_healthy" and other != "api":
                assert "test" in compose["services"][other]["healthcheck"]
        for volume in service.get("volumes", []):
            assert volume.split(":")[0] in compose["volumes"]
    assert "HEALTHCHECK" in (DEPLOY / "Containerfile").read_text()  # which api has from its image


def test_workers_have_names_of_their_own_and_share_database_and_store(compose):
    workers = [s["environment"] for name, s in compose["services"].items() if name.startswith("worker")]
    assert len({w["AMBIT_WORKER_NAME"] for w in workers}) == len(workers) == 2
    api = compose["services"]["api"]["environment"]
    for worker in workers:
        assert worker["AMBIT_DATABASE_URL"] == api["AMBIT_DATABASE_URL"]
        assert worker["AMBIT_STORE_URL"] == api["AMBIT_STORE_URL"]
    shared = "store:/var/lib/ambit/store"
    assert all(shared in compose["services"][n]["volumes"] for n in ("api", "worker1", "worker2"))
    settings = load(None, environment={k: str(v).replace("${", "x{") for k, v in workers[0].items()})
    assert settings.jobs_database == settings.database


def test_no_password_is_written_down(compose):
    for path in DEPLOY.rglob("*"):
        if path.is_file():
            assert not re.search(r"(?i)password\s*[:=]\s*['\"]?[a-z0-9]{3,}", path.read_text()), path.name


def test_no_command_of_the_readme_carries_a_secret_on_its_command_line():
    text = (DEPLOY / "README.md").read_text()
    assert "$(" not in text
    (alias,) = re.findall(r"alias as-ambit='(.*?)'", text, re.DOTALL)
    assert "EnvironmentFile=-/etc/ambit/ambit.env" in alias


# ---- container file


def instructions() -> list[tuple[str, str]]:
    text = re.sub(r"\\\n", " ", (DEPLOY / "Containerfile").read_text())
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.strip().startswith("#")]
    return [tuple(line.split(None, 1)) for line in lines]


KNOWN = {
    *("FROM", "WORKDIR", "RUN", "ENV", "COPY", "USER", "VOLUME", "EXPOSE", "STOPSIGNAL", "HEALTHCHECK", "CMD"),
    *("ENTRYPOINT", "ARG", "LABEL"),
}


def test_the_container_file_is_well_formed():
    found = instructions()
    assert found[0][0] == "FROM"
    assert {name for name, _ in found} <= KNOWN
    for name, value in found:
        if name == "FROM":
            assert re.match(r"[\w./-]+:[\w.-]+( AS \w+)?$", value)
            assert ":latest" not in value
        if name in ("CMD", "ENTRYPOINT", "VOLUME") and value.startswith("["):
            assert yaml.safe_load(value)


def test_the_image_does_not_run_as_root_and_checks_its_health():
    last = [k for k, (name, _) in enumerate(instructions()) if name == "FROM"][-1]
    final = dict(instructions()[last:])
    assert final["USER"].split(":")[0].isdigit()
    assert int(final["USER"].split(":")[0]) > 0
    assert yaml.safe_load(final["HEALTHCHECK"].split(" CMD ")[1]) == ["python", "-m", "service.probe"]
    assert yaml.safe_load(final["ENTRYPOINT"]) == ["ambit"]
    assert_understood(yaml.safe_load(final["CMD"]))


def test_what_is_copied_is_there_and_not_ignored():
    allowed = {line[1:] for line in (DEPLOY / "Containerfile.dockerignore").read_text().splitlines() if line[:1] == "!"}
    for name, value in instructions():
        if name == "COPY" and not value.startswith("--from"):
            for source in value.split()[:-1]:
                assert (ROOT / source).exists(), source
                assert source in allowed, source


def test_what_is_installed_has_its_migrations_pages_and_styles(tmp_path):
    """The image and the bare PC install the product; a file that is left out of the package is missing there."""
    copy = tmp_path / "source"
    copy.mkdir()
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, copy)
    for name in ("sim", "drivers", "service"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__", "*.nb[ci]"))
    done = subprocess.run(
        [
            *(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"),
            *("--disable-pip-version-check", "--wheel-dir", str(tmp_path), str(copy)),
        ],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    (wheel,) = tmp_path.glob("*.whl")
    inside = set(zipfile.ZipFile(wheel).namelist())
    wanted = {
        str(path.relative_to(ROOT))
        for package in ("sim", "drivers", "service")
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and path.suffix not in (".nbi", ".nbc", ".pyc")
    }
    assert wanted - inside == set()
