"""Links: outages, losses and delays are as asked for, and nothing is drawn without faults."""

import numpy as np
import pytest
from graphs import line
from hypothesis import given, settings
from hypothesis import strategies as st

from sato.network.channel import NEVER, Channel, Outages
from sato.network.link import Link
from sato.network.outages import PairOutages
from sato.scenario.errors import InputError


def runs(is_down):
    """Lengths of the times down and up of one link, but for the first and the last."""
    ends = np.flatnonzero(np.diff(is_down)) + 1
    lengths = np.diff(ends)
    first = is_down[ends[:-1]]
    return lengths[first], lengths[~first]


@pytest.mark.parametrize(("outage", "share"), [(1.0, 0.3), (5.0, 0.5), (8.0, 0.8)])
def test_outages_have_their_share_of_the_time_from_the_first_round_on(outage, share):
    link = Link(outage=outage, outage_share=share, round=1.0)
    is_down = Outages(link, 20_000, np.random.default_rng(0)).draw(60)
    # Binomial in each round, for links are independent.
    deviation = (share * (1 - share) / len(is_down)) ** 0.5
    assert np.abs(is_down.mean(axis=0) - share).max() < 5 * deviation


@pytest.mark.parametrize(("outage", "share"), [(1.0, 0.3), (5.0, 0.5), (8.0, 0.8)])
def test_outages_are_of_all_lengths_up_to_the_longest_alike(outage, share):
    link = Link(outage=outage, outage_share=share, round=1.0)
    is_down = Outages(link, 40, np.random.default_rng(1)).draw(5000)
    down, up = (np.concatenate(part) for part in zip(*map(runs, is_down), strict=True))
    counts = np.bincount(down)
    assert counts[0] == 0 and len(counts) == link.outage_rounds + 1 and up.min() == 1
    expected = len(down) / link.outage_rounds
    assert np.abs(counts[1:] - expected).max() < 5 * expected**0.5
    assert up.mean() == pytest.approx(link.mean_up_rounds, rel=5 / len(up) ** 0.5)


def test_outages_of_links_are_independent_and_of_both_directions():
    link = Link(outage=4.0, outage_share=0.5, round=1.0)
    is_down = PairOutages(link, 5, np.random.default_rng(2)).look_ahead(40_000)
    assert np.array_equal(is_down, is_down.transpose(0, 2, 1))
    assert not is_down[:, np.arange(5), np.arange(5)].any()
    i, j = np.triu_indices(5, 1)
    correlation = np.corrcoef(is_down[:, i, j].T) - np.eye(len(i))
    assert np.abs(correlation).max() < 0.05  # some 10,000 independent times


@given(st.lists(st.tuples(st.booleans(), st.integers(1, 5)), max_size=8))
@settings(deadline=None)
def test_rounds_that_were_looked_at_come_as_they_were_seen(looks):
    link = Link(outage=3.0, outage_share=0.5, round=1.0)
    outages, seen = PairOutages(link, 4, np.random.default_rng(3)), []
    for is_look, rounds in looks:
        if is_look:
            seen = list(outages.look_ahead(rounds)) + seen[rounds:]
            continue
        for _ in range(rounds):
            now = outages.advance()
            if seen:
                assert np.array_equal(now, seen.pop(0))


def draw(link, rounds, agents=12):
    channel = Channel(link, line(agents), np.random.default_rng(4))
    channel.extend(rounds)
    count = channel.by_round.T.shape[1]
    is_lost = channel.by_round.T == NEVER
    return channel, is_lost, channel.by_round.T - np.arange(1, count + 1)


def test_losses_and_delays_are_of_each_message_and_independent():
    link = Link(loss_probability=0.2, late=3)
    _, is_lost, late = draw(link, 8000)
    edges, count = is_lost.shape
    assert is_lost.mean() == pytest.approx(0.2, abs=5 * (0.16 / is_lost.size) ** 0.5)
    for rounds in range(4):
        share = (late == rounds).sum() / (~is_lost).sum()
        assert share == pytest.approx(0.25, abs=5 * (0.19 / is_lost.size) ** 0.5)
    near = 5 / count**0.5
    numbers = np.where(is_lost, -1, late)
    assert np.abs(np.corrcoef(is_lost) - np.eye(edges)).max() < near
    assert np.abs(np.corrcoef(numbers) - np.eye(edges)).max() < near
    one_later = [np.corrcoef(each[:-1], each[1:])[0, 1] for each in numbers]
    assert np.abs(one_later).max() < near


def test_messages_are_lost_both_ways_in_an_outage_and_else_by_their_losses():
    link = Link(loss_probability=0.1, outage=5.0, outage_share=0.5, round=1.0)
    channel, is_lost, _ = draw(link, 8000)
    edges = zip(channel.sender.tolist(), channel.receiver.tolist(), strict=True)
    place = {edge: e for e, edge in enumerate(edges)}
    back = [place[j, i] for i, j in place]
    # Both in outages, and by two independent losses otherwise.
    assert (is_lost & is_lost[back]).mean() == pytest.approx(0.5 + 0.5 * 0.1**2, abs=0.02)
    assert is_lost.mean() == pytest.approx(0.5 + 0.5 * 0.1, abs=0.02)


@pytest.mark.parametrize("link", [Link(), Link(round=0.1), Link(late=2, skew=1.0, round=0.1)])
def test_nothing_is_drawn_for_links_without_outages(link):
    rng = np.random.default_rng(5)
    before = rng.bit_generator.state
    assert not PairOutages(link, 5, rng).look_ahead(30).any()
    assert not PairOutages(link, 5, rng).advance().any()
    assert rng.bit_generator.state == before


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"loss_probability": 1.0}, "loss: must be less than 1, got 1"),
        ({"late": -1}, "late: must be at least 0"),
        ({"outage": 1.0}, "outage_share: is 0, and outage_s is not"),
        ({"outage_share": 0.5}, "outage_s: is 0, and outage_share is not"),
        (
            {"outage": 2.0, "outage_share": 0.8, "round": 1.0},
            r"outage_share: 0.8 with outages of 1.5 rounds .* at most 0.6, or outage_s = 7 would",
        ),
    ],
)
def test_impossible_links_are_refused(keys, message):
    with pytest.raises(InputError, match=message):
        Link(**keys)


@pytest.mark.parametrize("cure", [{"outage_share": 0.6}, {"outage": 7.0}])
def test_outages_that_are_suggested_are_allowed(cure):
    assert Link(**({"outage": 2.0, "outage_share": 0.8, "round": 1.0} | cure))
