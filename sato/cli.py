"""Command line; heavy imports stand inside the commands."""

import gc
import json
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option, Typer

import sato
from sato.cli_campaign import campaign_app
from sato.cli_errors import EXIT_FAILED, EXIT_OK, CommandGroup, ensure_writable, save_somewhere
from sato.scenario.errors import InputError
from sato.terminal import echo

GARBAGE_THRESHOLD = 50_000  # new objects after which cycles are looked for; by default 700: +10 %

app = Typer(
    cls=CommandGroup,
    help="Planning for swarms of vehicles: assignment, trajectories, formation, connectivity.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # rich takes longer to import than the help to read
)

app.add_typer(campaign_app, name="campaign")

OutFolder = Annotated[Path | None, Option("--out", metavar="DIR", help="That of the run.")]
RunFolder = Annotated[Path, Argument(metavar="DIR", help="Folder of a run.")]
Scenario = Annotated[str, Argument(metavar="NAME|FILE.toml", help="Built-in scenario, or a file.")]
Word = str | None
Words = list[str] | None
Numbers = list[float] | None
Overrides = Annotated[
    Words, Option("--set", metavar="TABLE.KEY=VALUE", help="Change the scenario, none: take away.")
]


def main() -> None:
    """Run the command line."""
    gc.set_threshold(GARBAGE_THRESHOLD)
    app(prog_name="sato")


# CPython keeps frames in blocks of 16 KiB, and frees a block as soon as its first frame returns.
# A loop whose calls straddle two blocks maps and unmaps memory at every call: 2 s of a first run.
# A frame with room for a large stack begins a block of a megabyte.
main.__code__ = main.__code__.replace(co_stacksize=100_000)


@app.callback(invoke_without_command=True)
def _print_version(
    version: Annotated[bool, Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        echo(sato.__version__)
        raise Exit(EXIT_OK)


@app.command()
def scenarios() -> None:
    """List the built-in scenarios."""
    for name, line in sato.scenarios().items():
        echo(f"{name:18} {line}")


@app.command()
def show(scenario: Scenario, override: Overrides = None) -> None:
    """Print a whole scenario, defaults filled in, as TOML."""
    echo(sato.read(scenario, override or ()).to_toml(), nl=False)


@app.command()
def keys(system: Annotated[str, Argument(metavar="SYSTEM", help="Name of a system.")]) -> None:
    """List the keys of a system's scenario files: unit, default, values and meaning."""
    from sato.keys import format_keys

    echo(format_keys(system), nl=False)


@app.command()
def run(
    scenario: Scenario,
    seed: Annotated[int, Option(min=0, max=2**64 - 1, help="Random seed.")] = 0,
    out: Annotated[Path | None, Option(metavar="DIR", help="Folder; runs/NAME-SEED.")] = None,
    override: Overrides = None,
    quiet: Annotated[bool, Option("--quiet", help="Print errors and warnings only.")] = False,
    processes: Annotated[
        bool, Option("--processes", help="Each vehicle a process, in lock step.")
    ] = False,
    free_running: Annotated[
        bool, Option("--free-running", help="Each vehicle a process, by the clock.")
    ] = False,
    port: Annotated[
        int | None, Option(min=1, max=65535, help="Port of processes; a socket.")
    ] = None,
    speed: Annotated[
        float, Option(min=1e-3, max=1e3, help="Of processes that run freely, over the clock's.")
    ] = 1.0,
) -> None:
    """Fly a scenario; write DIR/run.nc and DIR/summary.json."""
    from sato.console import print_summary
    from sato.record import RUN_FILE

    name = sato.read(scenario, override or ()).name
    folder = out or Path("runs", f"{name}-{seed}")
    ensure_writable(folder)
    flown = sato.run(
        scenario,
        seed=seed,
        overrides=override or (),
        progress=not quiet,
        processes="free-running" if free_running else "lock-step" if processes else None,
        port=port,
        speed=speed,
    )
    is_old = (folder / RUN_FILE).exists()
    save_somewhere(flown, folder)
    if is_old and not quiet:
        echo(f"sato: {folder}: the run that was there is overwritten", err=True)
    if not quiet:
        echo(flown.report.line)
        print_summary(flown.summary, folder)
    raise Exit(EXIT_OK if flown.report.kept else EXIT_FAILED)


@app.command()
def vehicle(
    number: Annotated[int, Argument(metavar="NUMBER", min=0, help="Of the vehicle.")],
    key_file: Annotated[
        Path, Option(metavar="FILE", help="Key of the flight, which `sato run` names.")
    ],
) -> None:
    """Start the process of a vehicle whose own was killed; it joins the flight."""
    from sato.processes.vehicle_process import run_vehicle

    run_vehicle(key_file, number)


@app.command()
def check(
    folder: RunFolder,
    as_json: Annotated[bool, Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Check a run by recomputing it from its file alone; exit 1 unless all is kept and reached."""
    from sato.console import print_report, progress_bar
    from sato.run_data import json_default

    with progress_bar("recomputing the run"):
        loaded = sato.load(folder)
        report = loaded.report
    if as_json:
        echo(json.dumps(report.as_dict(), indent=2, default=json_default))
    else:
        echo(report.line)
        print_report(report)
    if report.failure:
        loaded.check()  # raises what it failed by
    raise Exit(EXIT_OK if report.kept else EXIT_FAILED)


@app.command()
def plot(
    folder: RunFolder,
    pdf: Annotated[bool, Option("--pdf", help="PDF instead of PNG.")] = False,
    out: OutFolder = None,
) -> None:
    """Draw the figures of a run into its folder, or another."""
    from sato.console import progress_bar

    place = out or _run_folder(folder)
    ensure_writable(place)
    with progress_bar("drawing"):
        figures = sato.load(folder).plot(place, pdf=pdf)
    for path in figures:
        echo(str(path))


@app.command()
def animate(folder: RunFolder, out: OutFolder = None) -> None:
    """Animate a run into its folder, or another: MP4, or GIF where ffmpeg is missing or fails."""
    from sato.console import progress_bar

    place = out or _run_folder(folder)
    ensure_writable(place)
    with progress_bar("animating") as progress:
        path = sato.load(folder).animate(place, progress=progress)
    echo(str(path))


@app.command()
def player(
    folder: RunFolder,
    out: Annotated[
        Path | None, Option("--out", "-o", metavar="FILE.html", help="DIR/player.html, if absent.")
    ] = None,
) -> None:
    """Write a run as one HTML file, which plays in a browser without a network."""
    from sato.console import progress_bar
    from sato.player import DEFAULT_NAME

    path = out or _run_folder(folder) / DEFAULT_NAME
    ensure_writable(path.parent)
    with progress_bar("writing the player"):
        sato.load(folder).player(path)
    echo(str(path))


@app.command()
def export(
    folder: RunFolder,
    format: Annotated[
        str, Option(metavar="oem|csv|rrd", help="CCSDS OEM, a table, or for Rerun.")
    ] = "oem",
    out: Annotated[Path | None, Option(metavar="PATH", help="In DIR, if absent.")] = None,
) -> None:
    """Write the trajectories of a run for other tools."""
    from sato.export import DEFAULT_PATHS

    path = out or _run_folder(folder) / DEFAULT_PATHS.get(format, format)
    ensure_writable(path.parent)
    echo(str(sato.load(folder).export(path, format)))


@app.command()
def gains(
    formation: Annotated[Word, Argument(metavar="NAME|FILE.csv", help="Name or points [m]")] = None,
    graph: Annotated[str, Option(metavar="own|complete|FILE", help="FILE lists pairs.")] = "own",
    method: Annotated[str, Option(metavar="auto|projection|sdp|admm|paper")] = "auto",
    joint: Annotated[bool, Option("--joint", help="One rate in the plane and vertical.")] = False,
    out: Annotated[Path | None, Option(metavar="FILE.npz", help="gains/NAME.npz.")] = None,
    list_library: Annotated[bool, Option("--list", help="List the library.")] = False,
) -> None:
    """Design the gains of a formation; write them with their certificate."""
    from sato import gains_report
    from sato.scenario.definition import errors_in

    if list_library:
        gains_report.print_formations()
        raise Exit(EXIT_OK)
    with errors_in(""):
        if formation is None:
            raise InputError("", "gains takes NAME or FILE.csv; --list has the names")
        shape = gains_report.resolve_formation(formation, graph)
        file = out or Path("gains", shape.name.replace("/", "-").replace(" ", "-") + ".npz")
        if file.suffix != ".npz" or file.is_dir():
            raise InputError("", f"{file}: --out takes a file that ends in .npz")
        ensure_writable(file.parent)
    gains_report.design_and_save(shape, method, file, joint)


@app.command()
def compare(
    family: Annotated[Words, Option(metavar="NAME", help="Of problems; repeatable; all.")] = None,
    solver: Annotated[Words, Option(metavar="NAME", help="Repeatable; all installed.")] = None,
    tolerance: Annotated[Numbers, Option(metavar="T", help="Repeatable; 1e-6.")] = None,
    size: Annotated[Words, Option(metavar="small|medium|large", help="Repeatable; small.")] = None,
    repeats: Annotated[int, Option(min=1, help="Times are medians of so many.")] = 3,
    patience: Annotated[
        float | None,
        Option(metavar="S", help="Skip the rest after a solve that took longer [s]; 0.15, or 1."),
    ] = None,
    seed: Annotated[int, Option(min=0, help="Random seed of the order of solves.")] = 0,
    out: Annotated[Path, Option(metavar="DIR", help="Folder to write.")] = Path("runs/compare"),
    takes_all: Annotated[
        bool, Option("--all", help="All sizes at 1e-4, 1e-6 and 1e-8; takes half an hour or more.")
    ] = False,
) -> None:
    """Solve one set of problems with every solver; exit 1 if the default solver is wrong."""
    from problems.solvers import load_adapters
    from sato.compare.plan import make_plan
    from sato.compare.report import run_comparison
    from sato.scenario.definition import errors_in

    chosen = (solver or (), family or (), size or (), tolerance or ())
    with errors_in(""):
        plan = make_plan(load_adapters(), *chosen, repeats, patience, takes_all)
    ensure_writable(out)
    violations = run_comparison(plan, out, seed)
    for text in violations:
        echo(f"sato: {text}", err=True)
    raise Exit(EXIT_FAILED if violations else EXIT_OK)


@app.command(name="export-c")
def export_c(
    out: Annotated[Path, Option(metavar="DIR", help="New folder for the C code.")],
    scenario: Annotated[str, Option(metavar="NAME|FILE.toml", help="Of the agent.")] = "uiuc",
    neighbors: Annotated[int, Option(metavar="K", min=1, help="Most neighbors.")] = 5,
    steps: Annotated[int | None, Option(metavar="T", min=2, help="The first leg's.")] = None,
) -> None:
    """Write C code that solves one agent's transfer among its neighbors, for on board."""
    from sato.console import progress_bar
    from sato.onboard import export_c as write
    from sato.onboard.export import describe
    from sato.scenario.definition import errors_in

    ensure_writable(out)
    with progress_bar("writing the code"), errors_in(""):
        problem = write(scenario, out, neighbors, steps)
    echo(describe(problem))
    echo(str(out))


def _run_folder(run: Path) -> Path:
    return run if run.is_dir() else run.parent
