"""The command line. Says what happened in a sentence, and keeps what takes long for later."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sato.plainly import DONE, SHORT, plainly, refuse_unwritable

if TYPE_CHECKING:
    from sato.record import Run

app = typer.Typer(
    help="Planning for swarms of vehicles: who goes where, and how to get there.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # its help would take longer to import than to read
)

RunFolder = Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a run.")]


def main() -> None:
    """Entry point."""
    app()


@app.callback(invoke_without_command=True)
def _about(
    version: Annotated[bool, typer.Option("--version", help="Say the version and stop.")] = False,
) -> None:
    if version:
        from importlib.metadata import version as version_of

        typer.echo(version_of("sato"))
        raise typer.Exit(DONE)


@app.command()
def scenarios() -> None:
    """List the built-in scenarios."""
    with plainly():
        from sato.scenario import names

        known = names()
        width = max(map(len, known))
        for name, says in known.items():
            typer.echo(f"{name:{width}}  {says}")


@app.command()
def run(
    scenario: Annotated[
        str, typer.Argument(metavar="NAME|FILE.toml", help="A built-in scenario, or a file.")
    ],
    seed: Annotated[int, typer.Option(min=0, help="Of everything that is drawn.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where to write; runs/NAME-SEED.")
    ] = None,
    override: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="TABLE.KEY=VALUE", help="Change the scenario; repeatable."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Say nothing but what is wrong.")] = False,
) -> None:
    """Fly a scenario; write DIR/run.nc and DIR/summary.json."""
    with plainly():
        from sato.flying import run as fly
        from sato.record import RUN_FILE
        from sato.scenario import read
        from sato.systems import system
        from sato.terminal import progress, tell

        asked = read(scenario, override or ())
        folder = out or Path("runs", f"{asked.name}-{seed}")
        refuse_unwritable(folder)
        if not quiet and (folder / RUN_FILE).exists():
            typer.echo(f"sato: {folder}: the run that is there will be overwritten", err=True)
        with progress(quiet, system(asked.system).passage) as watch:
            flown = fly(asked, seed=seed, progress=watch)
        flown.save(folder)
        if not quiet:
            tell(flown, folder)
        raise typer.Exit(_verdict(flown))


@app.command()
def check(
    folder: RunFolder,
    as_json: Annotated[bool, typer.Option("--json", help="Everything, for a machine.")] = False,
) -> None:
    """Judge a run from its file alone; exit 1 if any promise is broken."""
    with plainly():
        from sato.record import load, plain
        from sato.terminal import tell_promises, waiting

        with waiting("judging the run by recomputing it"):
            report = load(folder).check()
        if as_json:
            typer.echo(json.dumps(report.as_dict(), indent=2, default=plain))
        else:
            tell_promises(report)
        raise typer.Exit(DONE if report.kept else SHORT)


@app.command()
def plot(
    folder: RunFolder,
    pdf: Annotated[bool, typer.Option("--pdf", help="PDF instead of PNG.")] = False,
) -> None:
    """Draw the figures of a run into its folder."""
    with plainly():
        from sato.plots import plot as draw
        from sato.record import load
        from sato.terminal import waiting

        with waiting("drawing"):
            figures = draw(load(folder), _folder_of(folder), pdf=pdf)
        for path in figures:
            typer.echo(str(path))


@app.command()
def animate(folder: RunFolder) -> None:
    """Film a run into its folder: MP4, or GIF where ffmpeg is missing."""
    with plainly():
        from sato.animate import animate as film
        from sato.record import load
        from sato.terminal import counted

        with counted("filming") as progress:
            film_at = film(load(folder), _folder_of(folder), progress=progress)
        typer.echo(str(film_at))


@app.command()
def export(
    folder: RunFolder,
    form: Annotated[
        str,
        typer.Option(
            "--format", metavar="oem|csv", help="CCSDS OEM, a file an object; or one table."
        ),
    ] = "oem",
    out: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Where to write; DIR/oem/ or DIR/trajectories.csv."),
    ] = None,
) -> None:
    """Write the trajectories of a run for other tools."""
    with plainly():
        from sato.export import HOME
        from sato.export import export as write
        from sato.record import load

        run = load(folder)
        typer.echo(str(write(run, out or _folder_of(folder) / HOME.get(form, form), form)))


@app.command()
def gains(
    formation: Annotated[
        str | None,
        typer.Argument(metavar="NAME|FILE.csv", help="Of the library, or points in metres."),
    ] = None,
    graph: Annotated[
        str,
        typer.Option(metavar="own|complete|FILE", help="Or pairs of vertices, counted from 0."),
    ] = "own",
    method: Annotated[
        str, typer.Option(metavar="auto|projection|sdp|admm|paper", help="How they are found.")
    ] = "auto",
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.npz", help="Where to write; gains/NAME.npz.")
    ] = None,
    known: Annotated[bool, typer.Option("--list", help="List the library and stop.")] = False,
) -> None:
    """Design the gains of a formation; write them with what is certain of them."""
    with plainly():
        from sato.gains_command import asked, home_of, make, tell_formations

        if known:
            tell_formations()
            raise typer.Exit(DONE)
        if formation is None:
            raise ValueError("gains takes a formation, NAME or FILE.csv; --list has the names")
        shape = asked(formation, graph)
        file = out or home_of(shape)
        if file.suffix != ".npz" or file.is_dir():
            raise ValueError(f"{file}: --out takes a file that ends in .npz")
        refuse_unwritable(file.parent)
        make(shape, method, file)


@app.command()
def compare(
    family: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Of questions; repeatable; all.")
    ] = None,
    solver: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Repeatable; all installed ones.")
    ] = None,
    tolerance: Annotated[
        list[float] | None,
        typer.Option(metavar="T", help="Repeatable; 1e-4, 1e-6 and 1e-8."),
    ] = None,
    size: Annotated[
        list[str] | None, typer.Option(metavar="small|medium|large", help="Repeatable; all.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Of which times are medians.")] = 3,
    patience: Annotated[
        float, typer.Option(metavar="S", help="Who took longer is asked for nothing larger.")
    ] = 1.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the order in which they are asked.")] = 0,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where to write.")] = Path(
        "runs", "compare"
    ),
) -> None:
    """Ask every solver the same, and judge every answer; exit 1 if the default one is wrong."""
    with plainly():
        from sato.compare.command import asked, make

        what = asked(solver or (), family or (), size or (), tolerance or (), repeats, patience)
        refuse_unwritable(out)
        broken = make(what, out, patience, seed)
        for words in broken:
            typer.echo(f"sato: {words}", err=True)
        raise typer.Exit(SHORT if broken else DONE)


@app.command(name="export-c")
def export_c(
    out: Annotated[Path, typer.Option(metavar="DIR", help="A new folder, for the C.")],
    scenario: Annotated[
        str, typer.Option(metavar="NAME|FILE.toml", help="Of which an agent is.")
    ] = "uiuc",
    neighbours: Annotated[
        int, typer.Option(metavar="K", min=1, help="That there is room for.")
    ] = 5,
    steps: Annotated[
        int | None, typer.Option(metavar="T", min=2, help="Of a flight; the first leg's.")
    ] = None,
) -> None:
    """Write C that solves one agent's transfer among its neighbours, for on board."""
    with plainly():
        from sato.onboard import export_c as write
        from sato.onboard.export import tell
        from sato.terminal import waiting

        refuse_unwritable(out)
        with waiting("writing the code"):
            written = write(scenario, out, neighbours, steps)
        typer.echo(tell(written))
        typer.echo(str(out))


def _folder_of(run: Path) -> Path:
    return run if run.is_dir() else run.parent


def _verdict(run: "Run") -> int:
    said = run.summary
    came = any(said.get(word) for word in ("reached", "success"))  # as each system calls it
    done = came and said.get("broken") == [] and "stopped" not in said
    return DONE if done else SHORT
