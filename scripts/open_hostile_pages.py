"""Open pages of runs and campaigns with hostile texts in headless Chromium; nothing may happen.

Every text is put into all fields of a run file of each system at once, those that are refused one
by one, and into the cells, columns and definition of a campaign. Player, report, notebook and SVG
figures are opened: a script that runs, a dialog, a request to anything but the page, an element
that no page of ours has, or anything but a sentence of a refusal is listed. Exit 1 where one is.

    python scripts/open_hostile_pages.py --count 60
"""

import json
import shutil
import sqlite3
import sys
import tempfile
import tomllib
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Annotated, Any

import h5py
import matplotlib
import tomli_w
import typer
from playwright.sync_api import Browser, Error, sync_playwright

import sato
from sato.campaigns.export import export as export_campaign
from sato.campaigns.figures import draw_campaign
from sato.campaigns.report import write_report
from sato.campaigns.table import CampaignTable, TableError
from sato.film import SwarmFilm
from sato.record import RUN_FILE, RunFileError
from sato.run_file import read_run_file
from sato.runs import Run
from sato.scenario.errors import InputError

FLAGS = [
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
HOST = "http://canary.invalid"
HIT = "top.__hit=1"
MARK = "Zq7"  # by which a text is found in a page
_LIVE = [
    f"<script>{HIT}</script>",
    f"</script><script>{HIT}</script>",
    f"</SCRIPT ><ScRiPt src={HOST}/x.js></sCrIpT>",
    f"<img src=x onerror={HIT}>",
    f'<img src="{HOST}/a.png">',
    f'"><img src={HOST}/b.png onerror={HIT}>',
    f"'><svg onload={HIT}>",
    f'" onmouseover="{HIT}" autofocus onfocus="{HIT}" x="',
    f"' onclick='{HIT}' onpointermove='{HIT}' x='",
    f"`onload={HIT}`",
    f"--><script>{HIT}</script><!--",
    f"--!><script>{HIT}</script>",
    f"]]><script>{HIT}</script><![CDATA[",
    f"</title><script>{HIT}</script>",
    f"</style><script>{HIT}</script>",
    f"</pre></td></table><script>{HIT}</script>",
    f"</textarea><script>{HIT}</script>",
    f"</noscript><script>{HIT}</script>",
    f"<svg><script>{HIT}</script></svg>",
    f"<svg><foreignObject><iframe src='javascript:{HIT}'></iframe></foreignObject></svg>",
    f"<svg><animate onbegin={HIT} attributeName=x dur=1s></svg>",
    f"<svg><use href='{HOST}/s.svg#x'></use><image href='{HOST}/i.png'></image></svg>",
    f"<math><mtext></p><style><img src=x onerror={HIT}></style></mtext></math>",
    f"<iframe srcdoc='<script>{HIT}</script>'></iframe>",
    f"<iframe src=javascript:{HIT}>",
    f"<object data='{HOST}/o'></object><embed src='{HOST}/e'>",
    f"<link rel=stylesheet href={HOST}/c.css>",
    f"<style>@import url({HOST}/i.css); * {{ background: url({HOST}/u.png) }}</style>",
    f"<base href={HOST}/>",
    f"<meta http-equiv=refresh content='0; url={HOST}/m'>",
    f"<form action={HOST}/f><input name=a autofocus onfocus={HIT}></form>",
    f"<video src={HOST}/v.mp4 onerror={HIT}></video>",
    f"<details open ontoggle={HIT}>x</details>",
    f"<body onload={HIT}>",
    f"<template><script>{HIT}</script></template><dialog open>x</dialog>",
    "<script>alert(1)</script><script>confirm(1)</script>",
    f"<script type=module>import '{HOST}/m.js'</script>",
    f"<scr\0ipt>{HIT}</scr\0ipt><img\0src=x onerror={HIT}>",
    f"<div style='background: url({HOST}/d.png)'>x</div>",
    f"<?xml-stylesheet href='{HOST}/x.xsl'?><!DOCTYPE x [<!ENTITY e SYSTEM '{HOST}/e'>]>&e;",
]
_ODD = [
    f"javascript:{HIT}",
    f"data:text/html,<script>{HIT}</script>",
    f"url({HOST}/t.png); background-image: url({HOST}/t2.png)",
    f"&lt;script&gt;{HIT}&lt;/script&gt; &#60;b&#62; &amp;amp; &NewLine;",
    f"\\u003cscript\\u003e{HIT}\\u003c/script\\u003e \\x3cb\\x3e",
    f"${{{HIT}}} {{{{constructor.constructor('{HIT}')()}}}} <%= {HIT} %> #{{{HIT}}}",
    f"'; {HIT}; '\"; {HIT}; //`; {HIT};",
    "@TITLE@ @DATA@ @PLAYER@ @VERDICT@ \\g<0> \\1 %s %(x)s {0} {name}",
    f"[x](javascript:{HIT}) ![y]({HOST}/md.png) <{HOST}/auto> `code` | cell | # head",
    f"[link={HOST}]rich[/link] [/red][bold]x[/] [@click=app.quit]x[/]",
    rf"$\href{{javascript:{HIT}}}{{x}}$ \(\input{{/etc/passwd}}\) $$\def\x{{\x}}\x$$",
    r"$\undefined$ $x^{$ $ \$ $$ \frac{1}{ \begin{verbatim}",
    "\x1b]0;title\x07\x1b[2J\x1b]8;;http://canary.invalid\x07x\x9b31m",
    "\u202etxt.exe\u202d\u2066 \u200b\ufeff \u2028\u2029 \U000e0041",
    "\x00\x01\x08\x0b\x0c\x7f\x85\ufffe\uffff",
    "\ud800\udc00\ud83d x \udfff\udc80\udcff",
    "__proto__ constructor toString hasOwnProperty",
    "\r\nMETA_STOP\r\nCOMMENT x\n=cmd|' /C calc'!A0,\t\"quoted\",;",
    "Z" * 20_000 + f"<script>{HIT}</script>",
    "ا\u0308" * 300 + "東京" * 50 + "👩‍🚀" * 20,
]
TEXTS = [f"{text} {MARK}" for text in (*_LIVE, *_ODD)]
JOINED = " ".join(text for text in TEXTS if len(text) < 1000)
RUNS = {
    "crossing": (),
    "orbit": ("swarm.agents=3",),
    "formation": ("protocol.limit_s=9",),
    "connectivity": ("run.duration_s=1", "swarm.agents=3"),
}
# Elements and attributes that no page of ours has.
OURS = """() => [...document.querySelectorAll("*")].flatMap(element => {
  const known = /^(#|data:,|data:image\\/png;base64,)/, name = element.localName, found = [];
  const links = /^(src|href|xlink:href|action|data|poster|background|srcdoc)$/;
  const bad = ["a", "iframe", "object", "embed", "base", "form", "foreignObject", "animate", "set",
    "template", "dialog", "details", "video", "audio", "b", "textarea", "math", "parsererror"];
  if (bad.includes(name)) found.push(name);
  for (const { name: key, value } of element.attributes) {
    const isOurs = !key.startsWith("on") && (!links.test(key) || known.test(value));
    if (!isOurs) found.push(`${name} ${key}`);
  }
  return found;
})"""
PLAY = """() => {
  const { run } = player, fire = (element, type) => element?.dispatchEvent(new Event(type));
  for (let i = 0; i < run.colorings.length; i++) {
    document.getElementById("coloring").value = i;
    fire(document.getElementById("coloring"), "change");
  }
  player.follow(0);
  for (const time of [run.start, run.end]) { player.seek(time); player.jump(-1); player.jump(1); }
  const told = run.events.map((event) => player.lanes.describe(event));
  document.getElementById("event").textContent = told.join();
  for (const button of document.querySelectorAll("button")) button.click();
  for (const element of document.querySelectorAll("*:not(#lanes)")) {
    for (const type of ["mouseover", "pointermove", "focus", "click"]) fire(element, type);
  }
}"""


class Visitor:
    """Browser that opens pages, and tells what they do beside being shown."""

    def __init__(self, browser: Browser) -> None:
        self.browser, self.text = browser, ""

    def visit(self, path: Path) -> list[str]:
        """Open a page, use the player if it is one, and list all that it does beside."""
        page, did = self.browser.new_page(), list[str]()
        page.on("dialog", lambda dialog: (did.append("dialog"), dialog.dismiss()))
        page.on("popup", lambda popup: did.append("popup"))
        page.on("pageerror", lambda error: did.append(f"error: {error}"))
        page.on("websocket", lambda socket: did.append("socket"))

        def answer(route: Any) -> None:
            if route.request.url == path.as_uri():
                route.continue_()
            else:
                did.append(f"request {route.request.url}")
                route.abort()

        page.route("**/*", answer)
        page.goto(path.as_uri(), wait_until="load")
        if path.name == "player.html":
            page.wait_for_function("window.player || document.getElementById('problem').innerText")
            did += [text] if (text := page.inner_text("#problem")) else []
            did += [] if text else page.evaluate(PLAY) or []
        did += ["script runs"] if page.evaluate("window.__hit === 1") else []
        did += [f"element {text}" for text in page.evaluate(OURS)]
        scripts = page.evaluate("document.querySelectorAll('script').length")
        did += [f"{scripts} scripts"] if scripts != 3 * (path.name == "player.html") else []
        self.text = page.evaluate("document.documentElement.textContent")
        page.close()
        return [text[:200] for text in did]


def list_fields(origin: Path) -> Iterator[str]:
    """Yield all fields of a saved run that are, or could be, a text."""
    with h5py.File(origin / RUN_FILE) as opened:
        yield from (f"attribute: {name}" for name in {*opened.attrs, "stopped", "center", "more"})
        yield from ("units: time", "units: event", "long_name: all", "note: all")
        tables = tomllib.loads(str(opened.attrs["scenario"]))
    yield from (f"origin: {name}" for name in ("kind", "name", "overrides"))
    yield from (f"event: {name}" for name in ("kind", "time", "agents", "note", "key"))
    yield from (f"summary: {name}" for name in ("key", "verdict", "version", "scenario", "broken"))
    yield from (f"scenario: {address}" for address in _list_texts(tables))
    yield from (f"scenario: {name}" for name in ("leg.0.shape.text", "leg.0.name", "model.class"))
    yield from ("scenario: more", "scenario: leg.0.gains.method", "variable: more")


def _list_texts(tables: Any, head: str = "") -> Iterator[str]:
    for key, part in tables.items() if isinstance(tables, dict) else enumerate(tables):
        if isinstance(part, dict | list):
            yield from _list_texts(part, f"{head}{key}.")
        elif isinstance(part, str):
            yield f"{head}{key}"


def write_run(origin: Path, folder: Path, fields: list[str], text: str) -> None:
    """Copy a run with a text in fields that `list_fields` names, and a digest that fits it."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(origin, folder)
    summary = json.loads((folder / "summary.json").read_text())
    del summary["digest"]
    with h5py.File(folder / RUN_FILE, "r+") as opened:
        events = [json.loads(part) for part in opened["event"][()]]
        tables = tomllib.loads(str(opened.attrs["scenario"]))
        found = json.loads(opened.attrs["origin"])
        for kind, name in (field.split(": ") for field in fields if field != "attribute: digest"):
            key = text if name == "key" else name
            if kind == "attribute":
                _set(opened, name, text)
            elif kind == "origin":
                found |= {"kind": "file", name: [text] if name == "overrides" else text}
            elif kind == "event":
                for event in events[-3:]:
                    event[key] = text
            elif kind == "summary":
                summary[key] = text
            elif kind == "scenario":
                _put(tables, name, text)
            elif kind == "variable":
                opened.create_dataset("more", data=[1.0]).make_scale("more")
                _set(opened["more"], "units", text)
            else:
                for place in opened if name == "all" else [name]:
                    _set(opened[place], kind, text)
        opened["event"][...] = [json.dumps(event) for event in events]
        if any(field.startswith("scenario: ") for field in fields):
            _set(opened, "scenario", tomli_w.dumps(tables))
        if any(field.startswith("origin: ") for field in fields):
            opened.attrs["origin"] = json.dumps(found)
    with suppress(Exception):  # of a file that is refused, as `sato.load` will tell
        digest = read_run_file(folder / RUN_FILE).compute_digest()
        with h5py.File(folder / RUN_FILE, "r+") as opened:
            opened.attrs["digest"] = text if "attribute: digest" in fields else digest
    (folder / "summary.json").write_text(json.dumps(summary))


def _put(tables: Any, address: str, text: str) -> None:
    *heads, last = address.split(".")
    for head in heads:
        place = tables[int(head)] if isinstance(tables, list) else tables.setdefault(head, {})
        tables = place
    if last in ("text", "class"):
        tables.clear()
        tables |= {"kind": "text", "height_m": 20.0} if last == "text" else {"kind": "own"}
    tables[last] = text


def _set(owner: Any, name: str, text: str) -> None:
    """Set an attribute to a text, also to one that is none in its encoding."""
    raw = text.encode("utf-8", "surrogatepass")
    owner.attrs.create(name, raw, dtype=f"S{len(raw)}" if b"\0" in raw else h5py.string_dtype())


def write_pages(run: Run, out: Path) -> list[Path]:
    """Write all pages of a run."""
    drawn = _write_figures(run.figures(), out)
    film = SwarmFilm(run.scene())
    film.draw_frame(float(run.recorded["time"][-1]))
    film.canvas.draw()
    run.export(out / "run.csv", "csv")
    if "chief" in run.recorded:
        run.export(out / "oem")
    return [run.player(out / "player.html"), write_notebook([run, run.data], out, drawn), *drawn]


def _write_figures(figures: dict[str, Any], out: Path) -> list[Path]:
    paths = [out / f"{name}.svg" for name in figures]
    with matplotlib.rc_context({"svg.fonttype": "none"}):  # text as text
        for path, figure in zip(paths, figures.values(), strict=True):
            figure.savefig(path)
    return paths


def write_notebook(objects: list[Any], out: Path, drawings: list[Path]) -> Path:
    """Write what objects say that they are as HTML, and drawings, into one page."""
    # A notebook puts into its page what objects say that they are as HTML or SVG.
    shown = [part._repr_html_() for part in objects]
    shown += [f"<svg{path.read_text('utf-8').partition('<svg')[2]}" for path in drawings]
    page = out / "notebook.html"
    text = "\n".join(["<!doctype html><meta charset=utf-8><body>", *shown])
    page.write_text(text, "utf-8", errors="replace")  # of xarray, which keeps halves of pairs
    return page


def write_campaign(origin: Path, folder: Path, text: str) -> None:
    """Copy a campaign with a text in all cells, in names of columns, and in its definition."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(origin, folder)
    raw = text.encode("utf-8", "surrogatepass")
    name = text.replace("\0", "").encode("utf-8", "ignore").decode()
    with closing(sqlite3.connect(folder / "campaign.sqlite")) as opened:
        [(plain,)] = opened.execute("SELECT definition FROM campaign").fetchall()
        definition = json.loads(plain) | {"grid": {name: [text, 1], "other": [text, 2]}}
        definition |= {"by": [name, "other"], "case": {text: {"some": text}}}
        names = [name, "other", "error", "parameters", "scenario", "warnings", "worker"]
        for column in names[:2]:
            opened.execute(f'ALTER TABLE runs ADD COLUMN "{column.replace(chr(34), chr(34) * 2)}"')
        for column in names:
            quoted = column.replace('"', '""')
            opened.execute(f'UPDATE runs SET "{quoted}" = CAST(? AS TEXT) WHERE row % 2', (raw,))
        opened.execute("UPDATE runs SET exit = 'error' WHERE row % 2")
        opened.execute("UPDATE runs SET exit = CAST(? AS TEXT) WHERE row = 0", (raw,))
        values = (json.dumps(definition), raw)
        opened.execute("UPDATE campaign SET definition = ?, version = CAST(? AS TEXT)", values)
        opened.commit()


def write_campaign_pages(table: CampaignTable, out: Path) -> list[Path]:
    """Write all pages of a campaign."""
    drawn = _write_figures(draw_campaign(table), out)
    export_campaign(table, out / "runs.csv", "csv")
    objects = [table.to_pandas(), table.to_xarray()]
    return [write_report(table, out / "report.html"), write_notebook(objects, out, drawn), *drawn]


def attempt(make: Callable[[], list[Path]]) -> tuple[list[Path], str]:
    """Return pages, or a refusal, or a fault that begins with the name of an exception."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return make(), ""
    except (RunFileError, InputError, TableError) as error:
        return [], f"refused: {error}"
    except Exception as error:
        return [], f"{type(error).__name__}: {error}"


class Trials:
    """Pages that are written and opened, and what is wrong with them."""

    def __init__(self, visitor: Visitor, base: Path) -> None:
        self.visitor, self.folder, self.out = visitor, base / "used", base / "out"
        self.done, self.wrong = Counter[str](), Counter[str]()

    def use(self, label: str, make: Callable[[], list[Path]]) -> bool:
        """Write pages and open them; return True if they are not refused."""
        shutil.rmtree(self.out, ignore_errors=True)
        self.out.mkdir()
        pages, reason = attempt(make)
        self.done["refused"] += reason.startswith("refused: ")
        if reason and not reason.startswith("refused: "):
            self._blame(label, reason)
        for page in pages:
            for text in self.visitor.visit(page):
                self._blame(f"{label}, {page.name}", text)
            self.done[page.suffix if page.suffix == ".svg" else page.name] += 1
            self.done["pages with the text"] += MARK in self.visitor.text
        return not reason.startswith("refused: ")

    def _blame(self, label: str, text: str) -> None:
        print(f"{label}: {text[:300]!r}", flush=True)
        self.wrong[text[:40]] += 1

    def open_runs(self, origin: Path, texts: list[tuple[int, str]]) -> None:
        """Put each text into all fields of a run that take it at once, and into others alone."""

        def load(fields: list[str], text: str) -> Run:
            write_run(origin, self.folder, fields, text)
            return sato.load(self.folder)

        fields = sorted(list_fields(origin))
        taken, refused = list[str](), list[str]()
        for field in fields:
            is_taken = self._takes(lambda: load([field], TEXTS[0]))  # noqa: B023
            (taken if is_taken else refused).append(field)
        for number, text in texts:
            label = f"{origin.name}, text {number}"
            kept = taken
            if not self.use(label, lambda: write_pages(load(taken, text), self.out)):  # noqa: B023
                kept = [f for f in taken if self._takes(lambda: load([f], text))]  # noqa: B023
                self.use(label, lambda: write_pages(load(kept, text), self.out))  # noqa: B023
            for field in {*refused, *taken} - {*kept}:
                player = self.out / "player.html"
                self.use(f"{label}, {field}", lambda: [load([field], text).player(player)])  # noqa: B023
            self.done["fields"] += len(kept) + len(refused)
            print(f"{label} of {len(texts)}: {self.done.total()} done", file=sys.stderr, flush=True)

    def _takes(self, make: Callable[[], Run]) -> bool:
        return not attempt(lambda: [make()._readable_mission] and [])[1]

    def open_campaign(self, origin: Path, texts: list[tuple[int, str]]) -> None:
        """Put each text into all fields of a campaign."""

        def make(text: str) -> list[Path]:
            write_campaign(origin, self.folder, text)
            with CampaignTable(self.folder) as table:
                return write_campaign_pages(table, self.out)

        for number, text in texts:
            self.use(f"campaign, text {number}", lambda: make(text))  # noqa: B023


def count_live(visitor: Visitor, base: Path) -> int:
    """Count the texts that do something in a page that does not escape them."""
    page = base / "raw.html"
    live = 0
    for text in TEXTS:
        raw = text.encode("utf-8", "replace").decode()
        page.write_text(f"<!doctype html><meta charset=utf-8><pre>{raw}</pre>", "utf-8")
        try:
            live += bool(visitor.visit(page))
        except Error:  # the page is left for another
            live += 1
    return live


def main(
    count: Annotated[int, typer.Option(help="Texts.")] = len(TEXTS),
    first: Annotated[int, typer.Option(help="Number of the first.")] = 0,
    only: Annotated[str, typer.Option(help="Name of a run, or campaign.")] = "",
    is_joined: Annotated[bool, typer.Option("--joined", help="All but long ones as one.")] = False,
) -> None:
    """Open pages, and list what they do."""
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("there is no Chromium; `apt-get install chromium` installs one")
    texts = [(-1, JOINED)] if is_joined else list(enumerate(TEXTS))[first : first + count]
    base = Path(tempfile.mkdtemp(prefix="hostile-"))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        visitor = Visitor(browser)
        trials = Trials(visitor, base)
        for name, overrides in RUNS.items():
            if only in ("", name):
                sato.run(name, overrides=overrides).save(base / name)
                trials.open_runs(base / name, texts)
        if only in ("", "campaign"):
            grid = {"plan.step_s": [1.0, 2.0]}
            place = base / "campaign"
            sato.campaign("conflict", out=place, trials=2, grid=grid, workers=1).close()
            trials.open_campaign(place, texts)
        live = count_live(visitor, base)
        browser.close()
    shutil.rmtree(base)
    print(f"{len(texts)} texts, {live} of {len(TEXTS)} live where they are not escaped")
    print(", ".join(f"{number} {name}" for name, number in trials.done.items()))
    for text, number in trials.wrong.most_common():
        print(f"{number:6} {text!r}")
    sys.exit(bool(trials.wrong))


if __name__ == "__main__":
    typer.run(main)
