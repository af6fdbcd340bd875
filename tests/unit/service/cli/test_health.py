"""What a health check prints beside its figures."""

from service.cli.health import _show


def test_what_the_compared_model_lacks_is_said(capsys):
    document = {"alarm": False, "sentence": "rig: nothing drifted", "parameters": {}, "notes": ["the twin's drift"]}
    _show(document, {}, as_json=False)
    assert "note: the twin's drift" in capsys.readouterr().out
