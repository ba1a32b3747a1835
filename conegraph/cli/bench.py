"""``conegraph bench``: what the figures in the README come from."""

from __future__ import annotations

import typer

from conegraph.cli.bench_backends import backends
from conegraph.cli.bench_detector import detector
from conegraph.cli.bench_doctor import doctor
from conegraph.cli.bench_frontend import frontend
from conegraph.cli.bench_relocalisation import relocalisation
from conegraph.cli.bench_suite import diff, suite
from conegraph.cli.bench_track import track

app = typer.Typer(no_args_is_help=True, invoke_without_command=True)
app.callback()(suite)
app.command("diff")(diff)
app.command("backends")(backends)
app.command("detector")(detector)
app.command("doctor")(doctor)
app.command("frontend")(frontend)
app.command("relocalisation")(relocalisation)
app.command("track")(track)
