"""Gain matrix: the printed form, validation, and files."""

from dataclasses import replace

import numpy as np
import pytest
from gain_examples import graph_of

from problems.desired_formation import DesiredFormation
from problems.gain_design import GainMatrix, design_gains
from problems.gain_matrix import validate_gains
from sato.shapes.formation_library import load_formation, random_sparse_graph


def pyramid():
    return load_formation("Pentagonal Pyramid")


def full_matrix(gains):
    """Build A as the paper prints it, 3n × 3n [Lusk2020, eq. 3]."""
    n = len(gains.z)
    A = np.zeros((n, 3, n, 3))
    A[:, 0, :, 0] = A[:, 1, :, 1] = gains.xy.real
    A[:, 1, :, 0], A[:, 0, :, 1] = gains.xy.imag, -gains.xy.imag
    A[:, 2, :, 2] = gains.z
    return A.reshape(3 * n, 3 * n)


def random_formation(rng, n, share):
    points = rng.uniform(0, 1, (n, 3)) * [15, 15, 2]
    return DesiredFormation(points, random_sparse_graph(points, share, rng))


def test_kernel_and_spectrum_are_those_of_the_paper(rng):
    # Kernel as in [Lusk2020, eq. 4], of dimension 6; all else dies out.
    gains = design_gains(random_formation(rng, 7, 0.8))
    p, n = gains.formation.points, 7
    N = np.zeros((n, 3, 6))
    N[:, 0, 0], N[:, 1, 0], N[:, 0, 1], N[:, 1, 1] = p[:, 0], p[:, 1], -p[:, 1], p[:, 0]
    N[:, 2, 2] = p[:, 2]
    N[:, :, 3:] = np.eye(3)
    A = full_matrix(gains)
    assert np.abs(A @ N.reshape(3 * n, 6)).max() <= 1e-10
    λ = np.linalg.eigvalsh(A)
    assert λ[-6] > -1e-9 and λ[-7] == pytest.approx(-gains.convergence_rate, abs=1e-9)
    block = A[:3, 3:6]
    assert block[0, 0] == block[1, 1] and block[0, 1] == -block[1, 0]
    assert not block[2, :2].any() and not block[:2, 2].any()


def test_a_saved_file_restores_gains_and_formation(tmp_path):
    gains = design_gains(pyramid())
    gains.save(tmp_path / "gains.npz")
    again = GainMatrix.load(tmp_path / "gains.npz")
    assert np.array_equal(again.xy, gains.xy) and np.array_equal(again.z, gains.z)
    assert (again.method, again.bound_xy, again.bound_z) == ("admm", gains.bound_xy, gains.bound_z)
    assert again.formation.name == "swarm6_3d/Pentagonal Pyramid"
    assert again.matches_formation(pyramid())
    assert not again.matches_formation(DesiredFormation.with_complete_graph(pyramid().points))
    assert not again.matches_formation(DesiredFormation(pyramid().points * 2, pyramid().graph))
    assert not again.matches_formation(DesiredFormation.with_complete_graph(pyramid().points[:5]))


LOOSE = pyramid().graph & ~graph_of(6, [(0, 3)])
POINTS = pyramid().points


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (lambda g: {"points": POINTS * [1.1, 1, 1]}, "xy .* move the desired formation"),
        (lambda g: {"points": POINTS + np.eye(6, 3, -1)}, "for xy do not belong"),
        (lambda g: {"graph": LOOSE}, "are not zero at the non-edges"),
        (lambda g: {"xy": -g.xy}, "xy do not belong .*: they do not have eigenvalues of −1"),
        (lambda g: {"xy": 2 * g.xy}, "−1 in the mean"),
        (lambda g: {"xy": g.xy + np.triu(g.xy)}, "they "),
        (lambda g: {"z": g.z * np.nan}, "for z must be finite numbers"),
        (lambda g: {"z": 0 * g.z}, "for z must not all be 0"),
        (lambda g: {"points": POINTS[[0, 1, 2, 3, 4, 4]]}, "points 4 and 5 coincide"),
        (lambda g: {"graph": np.ones((6, 6))}, "float64"),
        (lambda g: {"points": np.array([["a", "b", "c"]] * 6)}, "<U1"),
        (lambda g: {"points": np.arange(6.0)}, ""),
        (lambda g: {"z": np.ones((3, 6))}, ""),
        (lambda g: {"z": np.ones((6, 6), dtype=complex)}, "complex128"),
        (lambda g: {"bounds": np.ones(3)}, "too many values"),
        (lambda g: {"bounds": np.array([np.nan, 1])}, "bound_xy: must be at least .* got nan"),
        (lambda g: {"bounds": np.array([1, 0.1])}, "bound_z: must be at least the rate 0.55"),
    ],
)
def test_file_with_a_wrong_field_is_refused_with_the_reason(tmp_path, changes, words):
    gains, path = design_gains(pyramid()), tmp_path / "gains.npz"
    gains.save(path)
    with np.load(path) as file:
        np.savez(path, **{**file, **changes(gains)})
    with pytest.raises(ValueError, match=rf"gains\.npz cannot be read as gains: .*{words}"):
        GainMatrix.load(path)


def test_gains_of_another_size_are_refused():
    # In tests, the annotated shape would be refused before the validation runs.
    with pytest.raises(ValueError, match=r"6 points need 6 × 6 gains, got \(5, 5\) for xy"):
        validate_gains(pyramid(), "xy", np.eye(5))


def test_unstable_gains_are_refused(rng):
    gains = design_gains(DesiredFormation.with_complete_graph(rng.normal(size=(6, 3))))
    K = gains.formation.kernel_z
    u = np.linalg.qr(np.column_stack([K, rng.normal(size=(6, 1))]))[0][:, 2]
    turned = gains.z + 1.5 * np.outer(u, u)
    turned *= -4 / turned.trace()
    with pytest.raises(ValueError, match="not stable: their rate is -"):
        replace(gains, z=turned)


def test_any_bound_from_the_rate_upwards_is_accepted(tmp_path):
    gains = design_gains(pyramid())
    assert replace(gains, bound_xy=gains.rate_xy, bound_z=gains.rate_z).gap_z == 0
    unknown = replace(gains, bound_xy=np.inf)
    unknown.save(tmp_path / "gains.npz")
    assert GainMatrix.load(tmp_path / "gains.npz").gap_xy == unknown.gap_xy == 1


def test_damaged_files_are_refused(tmp_path, rng):
    gains, path = design_gains(pyramid()), tmp_path / "gains.npz"
    gains.save(path)
    whole = path.read_bytes()
    for _ in range(300):
        broken = bytearray(whole[: rng.integers(len(whole))] if rng.random() < 0.5 else whole)
        if broken:
            broken[rng.integers(len(broken))] ^= int(rng.integers(1, 256))
        path.write_bytes(broken)
        try:
            read = GainMatrix.load(path)  # the change did not reach the matrices
            assert np.array_equal(read.xy, gains.xy) and np.array_equal(read.z, gains.z)
        except ValueError as error:
            assert "gains.npz" in str(error)


@pytest.mark.parametrize("content", [b"", b"points,graph", b"PK\x03\x04 and no more"])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "other.npz"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"other\.npz cannot be read as gains"):
        GainMatrix.load(path)


def test_files_without_a_field_are_refused(tmp_path):
    np.savez(tmp_path / "some.npz", points=np.zeros((3, 3)))
    np.save(tmp_path / "array.npy", np.zeros(3))
    for name, words in (("some.npz", "graph"), ("array.npy", "")):
        with pytest.raises(ValueError, match=rf"{name} cannot be read as gains.*{words}"):
            GainMatrix.load(tmp_path / name)
