"""Files that a stranger made: data alone, of a size that is known before it is read."""

import json
import os
import sqlite3
import struct
import sys
import zlib
from contextlib import closing
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from typer.main import get_command

import sato
from sato.atomic import PREFIX, replace_atomically
from sato.campaigns.engine import fly_again
from sato.campaigns.table import open_table
from sato.cli import app
from sato.files import LIMIT
from sato.record import RunFileError
from sato.scenario.errors import InputError, ScenarioError
from sato.terminal import STAND_IN, as_plain

sys.path.append(str(Path(__file__).parents[1] / "scripts"))

import mutate_files

ESCAPES = "\x1b]0;title\x07\x1b[2J\u202e[/red][bold]"


def call(*words):
    return CliRunner().invoke(get_command(app), [str(word) for word in words])


@pytest.fixture(scope="module")
def flown():
    return sato.run("crossing")


@pytest.fixture
def folder(flown, tmp_path):
    return flown.save(tmp_path / "run")


def hide_in(folder, change):
    with h5py.File(folder / "run.nc", "r+") as opened:
        change(opened)


def set_attribute(name, value):
    def change(opened):
        opened.attrs[name] = value

    return change


def link_virtually(opened):
    layout = h5py.VirtualLayout((3,), "f8")
    layout[:] = h5py.VirtualSource("other.nc", "time", (3,))
    opened.create_virtual_dataset("more", layout)


def unpack_twice(opened):
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_chunk((9,))
    for _ in range(2):
        layout.set_deflate(9)
    space = h5py.h5s.create_simple((9,))
    h5py.h5d.create(opened.id, b"more", h5py.h5t.NATIVE_UINT8, space, layout)


OUTSIDE = {
    "external": lambda f: f.create_dataset("more", (9,), "u1", external=[("/etc/passwd", 0, 9)]),
    "virtual": link_virtually,
    "soft link": lambda f: f.__setitem__("more", h5py.SoftLink("/time")),
    "external link": lambda f: f.__setitem__("more", h5py.ExternalLink("other.nc", "/time")),
    "group": lambda f: f.create_group("more"),
    "plug-in": lambda f: f.create_dataset("more", (9,), "f8", chunks=(3,), compression="lzf"),
    "references": lambda f: f.create_dataset("more", (3,), h5py.ref_dtype),
    "gzip of gzip": unpack_twice,
    "texts in rows": lambda f: f.create_dataset("more", (1, 9), h5py.string_dtype()),
    "texts in tables": lambda f: f.create_dataset("more", (3,), [("a", h5py.string_dtype())]),
}


@pytest.mark.parametrize("change", OUTSIDE.values(), ids=OUTSIDE)
def test_run_files_hold_their_values_themselves(folder, change):
    hide_in(folder, change)
    with pytest.raises(RunFileError, match=r"more (are not in this file|is of a kind)"):
        sato.load(folder)


def unpack_more_than_declared(opened):
    variable = opened.create_dataset("x", (9,), "u1", chunks=(9,), compression="gzip")
    packer = zlib.compressobj(9)
    parts = [packer.compress(bytes(10**7)) for _ in range(30)]
    variable.id.write_direct_chunk((0,), b"".join([*parts, packer.flush()]))


def add_scale(opened, **options):
    variable = opened.create_dataset("x", (10**8,), "i1", chunks=(10**6,), compression=9)
    variable.attrs.update(options)


def share_texts(opened):
    table = np.zeros(4000, [("a", h5py.string_dtype())])
    table["a"] = "y" * 9000
    opened.attrs["x"] = table


def add_events(opened):
    event = opened["event"][0].decode()[:-1] + ', "more": [' + "{}," * 200_000 + "{}]}"
    del opened["event"]
    opened.create_dataset("event", (12,), h5py.string_dtype())[:] = event


LARGE = {
    "variable": lambda f: f.create_dataset("x", (10**8,), "f8", chunks=(10**6,), compression=9),
    "chunk": lambda f: f.create_dataset("x", (1,), "f8", chunks=(10**8,), maxshape=(None,)),
    "texts": lambda f: f.attrs.create("x", ["y" * 9000] * 4000, dtype=h5py.string_dtype()),
    "gzip": unpack_more_than_declared,
    "scale": lambda f: add_scale(f, scale_factor=1.5),
    "scale of booleans": lambda f: add_scale(f, dtype="bool", scale_factor=1.5),
    "times of booleans": lambda f: add_scale(f, dtype="bool", units="days since 2000-01-01"),
    "texts in a table": share_texts,
    "events": add_events,
}


@pytest.mark.parametrize("change", LARGE.values(), ids=LARGE)
def test_contents_too_large_for_their_file_are_refused(folder, change):
    hide_in(folder, change)
    with pytest.raises(RunFileError, match=rf"unpacks to [\d,]+ MB, more .* {LIMIT}=\d+ in the"):
        sato.load(folder)


def test_limit_of_sizes_can_be_raised_and_lowered(folder, monkeypatch):
    hide_in(folder, lambda f: f.create_dataset("x", (10**6,), "f8", compression=9).make_scale("x"))
    assert "x" in sato.load(folder).recorded
    monkeypatch.setenv(LIMIT, "1")
    with pytest.raises(RunFileError, match="unpacks to 8 MB"):
        sato.load(folder)
    monkeypatch.setenv(LIMIT, "8.0")
    with pytest.raises(RunFileError, match=f"{LIMIT}: must be a whole number of MB"):
        sato.load(folder)


@pytest.mark.parametrize("keys", ['file = "/etc/passwd"', 'font = "/etc/x.ttf"\ntext = "A"'])
def test_scenario_in_a_run_names_no_file(flown, folder, keys):
    kind = "points" if "file" in keys else "text"
    shape = f'[[leg]]\nsteps = 9\n[leg.shape]\nkind = "{kind}"\n{keys}\n'
    text = flown.mission.to_toml().partition("[[leg]]")[0] + shape
    hide_in(folder, set_attribute("scenario", text))
    with pytest.raises(RunFileError, match=r"leg\.0\.shape\.(file|font): names a file"):
        sato.load(folder)


def test_digest_that_could_be_a_script_is_damage(folder):
    hide_in(folder, set_attribute("digest", "--><script>1</script>"))
    result = call("player", folder)
    assert result.exit_code == 2 and "its digest is" in result.output
    assert not (folder / "player.html").exists()


@pytest.mark.parametrize("name", ["origin", "name", "system", "stopped", "version"])
def test_texts_of_a_run_command_no_terminal_and_have_no_markup(folder, name):
    text = json.dumps({"kind": "file", "name": ESCAPES, "overrides": []})
    hide_in(folder, set_attribute(name, text if name == "origin" else ESCAPES))
    for words in (("check", folder), ("export", folder, "--out", folder / "x.oem")):
        result = call(*words)
        assert isinstance(result.exception, SystemExit | None) and "fault" not in result.output
        assert not set("\x1b\x07\u202e") & set(result.output)


def test_controls_are_spelled_out_and_all_else_is_kept():
    assert (
        as_plain("λ₂ ≥ 1\n\t[/red]\x1b\x9b\u2066\ud800")
        == "λ₂ ≥ 1\n\t[/red]\\x1b\\x9b\\u2066\\ud800"
    )


def test_ascii_stands_in_where_the_output_has_no_other_letters():
    text = "λ₂ ≥ 1 m/s², Δt → é ─ 東"
    assert text.encode("ascii", STAND_IN) == b"lambda2 >= 1 m/s^2, Deltat -> e ? ?"
    assert "≤ 1 m/s²".encode("latin-1", STAND_IN) == b"<= 1 m/s\xb2"


def test_links_within_a_run_are_not_followed(folder, tmp_path):
    (folder / "run.nc").rename(tmp_path / "elsewhere.nc")
    (folder / "run.nc").symlink_to(tmp_path / "elsewhere.nc")
    with pytest.raises(RunFileError, match="is a link, and none is followed"):
        sato.load(folder)
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere.nc")
    assert sato.load(tmp_path / "link").recorded  # the path of the user's may be one


def test_files_that_are_none_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    for shape in (sato.Points(file=str(tmp_path / "pipe.csv")), sato.Picture("/dev/zero")):
        with pytest.raises(ValueError, match="is no regular file"):
            shape.draw(3, 2)
    os.truncate(os.open(tmp_path / "large.toml", os.O_CREAT | os.O_WRONLY), 10**8)
    with pytest.raises(ScenarioError, match="unpacks to 3,000 MB"):
        sato.read(tmp_path / "large.toml")


def test_pictures_are_measured_before_they_are_unpacked(tmp_path):
    Image.new("1", (6000, 6000)).save(tmp_path / "large.png")
    with pytest.raises(ValueError, match="unpacks to 360 MB"):
        sato.Picture(str(tmp_path / "large.png")).draw(3, 2)


def test_many_tables_are_refused():
    data = sato.scenario.file.read_data("crossing")
    data["leg"] = data["leg"] * 10_001
    with pytest.raises(InputError, match="leg: has 10,001 tables; 10,000 or fewer would do"):
        sato.from_dict(data)


def test_figures_that_lack_their_values_are_left_out(folder):
    hide_in(folder, lambda f: f.__delitem__("rounds"))
    assert call("plot", folder).exit_code == 0 and not (folder / "messages.png").exists()


def test_damaged_epoch_is_told_where_it_is_asked_for(tmp_path):
    overrides = ["swarm.agents=2", "leg.0.steps=20"]
    folder = sato.run("orbit", overrides=overrides).save(tmp_path)
    hide_in(folder, set_attribute("epoch", "[]"))
    result = call("export", folder)
    assert result.exit_code == 2 and "the epoch or the body of the run is damaged" in result.output


def test_summary_of_another_run_is_not_paired(flown, folder, tmp_path):
    other = sato.run("crossing", seed=1).save(tmp_path / "other")
    (folder / "summary.json").write_text((other / "summary.json").read_text())
    assert sato.load(folder).claimed == {}
    assert sato.load(other).claimed["seed"] == 1


def test_what_a_killed_writer_left_goes_and_a_living_one_s_stays(folder):
    (folder / f"{PREFIX}dead").mkdir()
    (folder / f"{PREFIX}dead" / "run.nc").write_text("half")
    with replace_atomically(folder / "mine") as new:
        new.write_text("whole")
        sato.load(folder)
        assert [path.name for path in folder.glob(f"{PREFIX}*")] == [new.parents[1].name]
    assert (folder / "mine").read_text() == "whole" and not list(folder.glob(f"{PREFIX}*"))


# Campaigns


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign")
    sato.campaign("conflict", out=folder, trials=1, workers=1).close()
    return folder


def copied(campaign, tmp_path, *commands):
    """A copy of a campaign in which some SQL was executed."""
    (tmp_path / "campaign.sqlite").write_bytes((campaign / "campaign.sqlite").read_bytes())
    connection = sqlite3.connect(tmp_path / "campaign.sqlite")
    for command in commands:
        connection.execute(command)
    connection.commit()
    connection.close()
    return tmp_path


@pytest.mark.parametrize(
    "command",
    [
        "CREATE VIEW more AS SELECT 1",
        "CREATE TRIGGER more AFTER INSERT ON runs BEGIN SELECT 1; END",
        "CREATE INDEX more ON runs (seed)",
        "CREATE TABLE more (x)",
        "ALTER TABLE runs ADD COLUMN more AS (zeroblob(1000000000))",
        "ALTER TABLE runs ADD COLUMN more DEFAULT (1)",
        "ALTER TABLE runs RENAME TO more",
        "ALTER TABLE runs RENAME COLUMN worker TO more",
    ],
)
def test_tables_of_a_campaign_are_plain(campaign, tmp_path, command):
    folder = copied(campaign, tmp_path, command)
    result = call("campaign", "status", folder)
    assert result.exit_code == 2 and "is no campaign, for" in result.output


@pytest.mark.parametrize("name", [b"CREATE TABLE runs", b"scenarios", b"INTEGER PRIMARY KEY"])
def test_a_damaged_schema_of_a_campaign_is_told_in_words(campaign, tmp_path, name):
    folder = copied(campaign, tmp_path, "VACUUM")
    file = folder / "campaign.sqlite"
    file.write_bytes(file.read_bytes().replace(name, name[:3] + b"\xc5\x01(" + name[6:]))
    for word in ("status", "table"):
        result = call("campaign", word, folder)
        assert result.exit_code in (1, 2) and "campaign.sqlite" in result.output
        assert "fault of the program" not in result.output


def test_names_of_columns_are_text(campaign, tmp_path):
    folder = copied(campaign, tmp_path, 'ALTER TABLE runs ADD COLUMN "moreover" TEXT')
    file = folder / "campaign.sqlite"
    file.write_bytes(file.read_bytes().replace(b"moreover", b"more\xff\xfeer"))
    for words in (("export", "--out", tmp_path / "c.csv"), ("table", "--rows"), ("status",)):
        result = call("campaign", words[0], folder, *words[1:])
        assert result.exit_code == 2 and "no text" in result.output


@pytest.mark.parametrize(
    ("key", "value"),
    [("scenario", '["/etc/passwd"]'), ("scenario", '"x"'), ("trials", '"x"'), ("case", "1e308")],
)
def test_definition_of_a_campaign_names_no_file_and_is_checked(campaign, tmp_path, key, value):
    with closing(sqlite3.connect(campaign / "campaign.sqlite")) as connection:
        (text,) = connection.execute("SELECT definition FROM campaign").fetchone()
    changed = json.dumps(json.loads(text) | {key: json.loads(value)}).replace("'", "''")
    folder = copied(campaign, tmp_path, f"UPDATE campaign SET definition = '{changed}'")
    result = call("campaign", "table", folder)
    assert result.exit_code == 2 and "fault" not in result.output


@pytest.mark.parametrize(
    "command",
    [
        """UPDATE runs SET parameters = '{"leg.shape.file": "/etc/passwd"}', scenario_hash = '';""",
        'UPDATE scenarios SET text = \'name = "x"\n[leg.shape]\nfile = "/etc/passwd"\'',
    ],
)
def test_a_row_of_a_campaign_names_no_file(campaign, tmp_path, command):
    with open_table(copied(campaign, tmp_path, command)) as table:
        with pytest.raises(InputError, match=r"shape\.file; --trust reads it"):
            fly_again(table, 0)


def test_a_row_is_not_kept_where_a_link_leads(campaign, tmp_path):
    folder = copied(campaign, tmp_path)
    (folder / "runs").mkdir()
    (folder / "runs" / "0").symlink_to(campaign)
    with open_table(folder) as table, pytest.raises(InputError, match="runs/0: is a link"):
        fly_again(table, 0)


@pytest.mark.parametrize("end", ["-wal", "-shm", "-journal"])
def test_links_beside_the_table_of_a_campaign_are_refused(campaign, tmp_path, end):
    folder = copied(campaign, tmp_path)
    (folder / f"campaign.sqlite{end}").unlink(missing_ok=True)
    (folder / f"campaign.sqlite{end}").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match=f"{end}: is a link, and none is followed"):
        open_table(folder)
    assert not (tmp_path / "elsewhere").exists()


def test_a_table_whose_pages_lead_back_is_damaged(campaign, tmp_path):
    folder = copied(campaign, tmp_path)
    with sqlite3.connect(folder / "campaign.sqlite") as connection:
        connection.execute("PRAGMA journal_mode = DELETE")
        query = "SELECT rootpage FROM sqlite_master WHERE name = 'runs'"
        (root,) = connection.execute(query).fetchone()
        (size,) = connection.execute("PRAGMA page_size").fetchone()
    connection.close()
    data = bytearray((folder / "campaign.sqlite").read_bytes())
    # Interior pages, each with many cells that lead to the next, and one row in the last page.
    count, pages = 200, len(data) // size
    chain = [root, *range(pages + 1, pages + 13)]
    data += bytes(12 * size)
    for page, below in zip(chain, [*chain[1:], chain[-1]], strict=True):
        cells = b"".join(struct.pack(">IB", below, 1) for _ in range(count))
        first = size - len(cells)
        head = struct.pack(">BHHHBI", 5, 0, count, first, 0, below)
        places = b"".join(struct.pack(">H", first + 5 * k) for k in range(count))
        content = (head + places).ljust(first, b"\0") + cells
        if page == chain[-1]:
            row = b"\1\1\1"  # its payload, number, and an empty record
            head = struct.pack(">BHHHBH", 13, 0, 1, size - len(row), 0, size - len(row))
            content = head.ljust(size - len(row), b"\0") + row
        data[(page - 1) * size : page * size] = content
    data[28:32] = struct.pack(">I", len(data) // size)
    (folder / "campaign.sqlite").write_bytes(data)
    with pytest.raises(InputError, match=r"is damaged: .*page"):
        open_table(folder)


def test_files_and_links_of_a_campaign_are_not_followed(campaign, tmp_path):
    folder = copied(campaign, tmp_path)
    (folder / "runs").symlink_to(campaign)
    with open_table(folder) as table, pytest.raises(InputError, match="runs: is a link"):
        fly_again(table, 0)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "campaign.sqlite").symlink_to(folder / "campaign.sqlite")
    with pytest.raises(InputError, match="is a link, and none is followed"):
        open_table(tmp_path / "other")


@pytest.mark.parametrize("number", range(12))
def test_damaged_files_end_in_a_verdict_or_a_sentence(flown, campaign, tmp_path, number):
    rng = np.random.default_rng([11, number])
    if number % 3 == 0:
        folder = copied(campaign, tmp_path)
        told, reads = mutate_files.mutate_campaign(rng, folder), mutate_files.CAMPAIGN_READS
    else:
        folder = flown.save(tmp_path / "run")
        told, reads = mutate_files.mutate_run(rng, folder), mutate_files.READS[::4]
    for words in reads:
        split = 2 if words[0] == "campaign" else 1
        rest = [word.format(out=tmp_path) for word in words[split:]]
        assert mutate_files.use([*words[:split], str(folder), *rest]) == "", told


@pytest.mark.parametrize(
    "cell", ["parameters = ''", "parameters = 7", "error = CAST(x'd0' AS TEXT)"]
)
def test_cells_of_a_campaign_that_are_damaged_are_shown_as_they_are(campaign, tmp_path, cell):
    folder = copied(campaign, tmp_path, f"UPDATE runs SET exit = 'error', {cell}")
    for words in (("table", folder, "--rows"), ("report", folder, "--out", tmp_path / "r.html")):
        assert "fault" not in call("campaign", *words).output
