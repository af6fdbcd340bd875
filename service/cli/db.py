"""``ambit db``: upgrade, backup and restore of the service's databases and store."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.console import Json, print_json
from service.cli.installation import Config, Home
from service.remarks import say

app = typer.Typer(no_args_is_help=True, help="Databases and store of the service: upgrade, backup, restore.")


@app.command()
def upgrade(config: Config = None, home: Home = None, as_json: Json = False) -> None:
    """Bring both databases to the form of this version. Make a backup first; stop older workers."""
    from service.backup.restore import upgrade as upgraded
    from service.config import load

    before, after = upgraded(load(config, flags={"home": home}))
    if as_json:
        print_json({"before": before, "after": after})
    else:
        print(f"revision {before or 'none'} -> {after}")


@app.command()
def backup(
    out: Annotated[Path, typer.Option(help="Folder of the backups; all share its folder store.")],
    keep: Annotated[int | None, typer.Option(help="Remove all but so many backups afterwards.", min=1)] = None,
    config: Config = None,
    home: Home = None,
    as_json: Json = False,
) -> None:
    """Back up databases, controllers' files and store, while the service runs; prints the folder of this backup."""
    from service.backup.create import create, prune
    from service.cli.interrupt import kill_is_ctrl_c
    from service.config import load

    with kill_is_ctrl_c():
        path, made = create(load(config, flags={"home": home}), out)
    removed = prune(out, keep) if keep else []
    for name in made.missing:
        say(f"not in the backup, for it is missing, damaged or cannot be read: {name}")
    if as_json:
        document = {"path": str(path), "rows": made.rows, "blobs": made.blobs, "blob_bytes": made.blob_bytes}
        print_json(document | {"missing": list(made.missing), "removed": [str(p) for p in removed]})
    else:
        print(path)
    if made.missing:
        raise typer.Exit(1)


@app.command()
def restore(
    backup: Annotated[Path, typer.Argument(help="Folder of one backup, with its time as name; store lies beside it.")],
    replace: Annotated[
        bool, typer.Option("--replace", help="Give up what databases and controllers' files hold now.")
    ] = False,
    resume_jobs: Annotated[
        bool, typer.Option("--resume-jobs", help="Let jobs go on that were not finished: rotors move by themselves.")
    ] = False,
    config: Config = None,
    home: Home = None,
    as_json: Json = False,
) -> None:
    """Restore a backup into the databases, the home and the store that the settings name. Stop the service first."""
    from service.backup.restore import restore as restored
    from service.config import load

    held = restored(load(config, flags={"home": home}), backup, replace, resume_jobs)
    jobs = held.rows.get("jobs", 0)
    if as_json:
        print_json({"created": held.created, "rows": held.rows, "blobs": held.blobs, "missing": list(held.missing)})
    else:
        print(f"restored the state of {held.created}: {jobs} jobs, {held.blobs} files")
