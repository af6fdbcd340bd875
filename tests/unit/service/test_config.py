"""Settings: file, environment, flags; the later wins, and what is unknown is told with where it came from."""

import pytest

from service.config import load
from service.errors import ConfigurationError


def test_the_later_wins(tmp_path):
    file = tmp_path / "ambit.toml"
    file.write_text('port = 1\nhost = "10.0.0.1"\nworker_name = "w1"\n')
    settings = load(file, {"AMBIT_PORT": "2", "AMBIT_WORKER_NAME": "w2", "AMBIT_URL": "of the client"}, {"port": 3})
    assert (settings.port, settings.worker, settings.host) == (3, "w2", "10.0.0.1")
    assert load(None, {"AMBIT_CONFIG": str(file)}, {"port": None}).port == 1


def test_databases_are_in_home_unless_told_otherwise(tmp_path):
    settings = load(None, {"AMBIT_HOME": str(tmp_path)})
    assert settings.database == f"sqlite:///{tmp_path}/ambit.db"
    assert settings.jobs_database == f"sqlite:///{tmp_path}/jobs.db"
    pg = load(None, {"AMBIT_HOME": str(tmp_path), "AMBIT_DATABASE_URL": "postgresql://u:p@h/d"})
    assert pg.jobs_database == pg.database == "postgresql://u:p@h/d"


@pytest.mark.parametrize(
    ("told", "may"),
    [
        ({}, True),
        ({"AMBIT_HOST": "::1"}, True),
        ({"AMBIT_HOST": "0.0.0.0"}, False),
        ({"AMBIT_HOST": "10.0.0.1"}, False),
        ({"AMBIT_BEHIND_PROXY": "true"}, False),
        ({"AMBIT_PUBLIC_URL": "https://rotor.example.org"}, False),
        ({"AMBIT_DATABASE_URL": "postgresql://u:p@h/d"}, False),
        ({"AMBIT_HOST": "0.0.0.0", "AMBIT_WEBHOOK_LOOPBACK": "true"}, True),
        ({"AMBIT_WEBHOOK_LOOPBACK": "false"}, False),
    ],
)
def test_webhooks_lead_to_the_machine_itself_where_nobody_else_reaches_the_service(tmp_path, told, may):
    assert load(None, {"AMBIT_HOME": str(tmp_path), **told}).webhooks_to_itself is may


@pytest.mark.parametrize(
    ("text", "environment", "told"),
    [
        ("colour = 1", {}, "ambit.toml: colour: there is no such setting"),
        ("", {"AMBIT_PORT": "many"}, "AMBIT_PORT: port: "),
        ("", {"AMBIT_DATABASE_URL": "mysql://h/d"}, "neither sqlite"),
        ("", {"AMBIT_PUBLIC_URL": "rotor.example.org"}, "no address of a service"),
        ("port =", {}, "cannot read the settings"),
    ],
)
def test_mistakes_are_told(tmp_path, text, environment, told):
    file = tmp_path / "ambit.toml"
    file.write_text(text)
    with pytest.raises(ConfigurationError) as error:
        load(file, environment)
    assert told in str(error.value)
    assert "\n" not in str(error.value)
