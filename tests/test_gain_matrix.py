"""Gain matrix: the printed form, validation, and files."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from problems.desired_formation import DesiredFormation
from problems.gain_design import GainMatrix, design_gains
from problems.gain_matrix import _validate_gains
from sato.shapes.formation_library import load_formation
from sato.shapes.graphs import random_sparse_graph


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


def test_complex_gains_give_the_velocities_of_the_real_matrix(rng):
    gains = design_gains(random_formation(rng, 6, 0.9))
    q = rng.normal(size=(6, 3))
    speeds = (full_matrix(gains) @ q.ravel()).reshape(6, 3)
    planar = gains.xy @ (q[:, 0] + 1j * q[:, 1])
    assert_allclose(speeds[:, 0] + 1j * speeds[:, 1], planar, atol=1e-12)
    assert_allclose(speeds[:, 2], gains.z @ q[:, 2], atol=1e-12)


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


def changed_file(path, **changes):
    with np.load(path) as file:
        np.savez(path.with_name("changed.npz"), **{**file, **changes})
    return path.with_name("changed.npz")


def test_gains_of_another_formation_are_refused(tmp_path):
    gains = design_gains(pyramid())
    path = tmp_path / "gains.npz"
    gains.save(path)
    points = gains.formation.points
    loose = gains.formation.graph.copy()
    loose[0, 3] = loose[3, 0] = False
    for changes, words in (
        ({"points": points * [1.1, 1, 1]}, "changed.npz: .* xy .* move the desired formation"),
        ({"points": points + np.eye(6, 3, -1)}, "for xy do not belong"),
        ({"graph": loose}, "are not zero at the non-edges"),
        ({"xy": -gains.xy}, "xy do not belong .*: they do not have eigenvalues of −1"),
        ({"xy": 2 * gains.xy}, "−1 in the mean"),
        ({"xy": gains.xy + np.triu(gains.xy)}, "they "),
        ({"z": gains.z * np.nan}, "for z must be finite numbers"),
        ({"z": 0 * gains.z}, "for z must not all be 0"),
        ({"points": points[[0, 1, 2, 3, 4, 4]]}, "points 4 and 5 coincide"),
    ):
        with pytest.raises(ValueError, match=words):
            GainMatrix.load(changed_file(path, **changes))


def test_gains_of_another_size_are_refused():
    # In tests, the annotated shape would be refused before the validation runs.
    with pytest.raises(ValueError, match=r"6 points need 6 × 6 gains, got \(5, 5\) for xy"):
        _validate_gains(pyramid(), "xy", np.eye(5))


def test_unstable_gains_are_refused(rng):
    gains = design_gains(DesiredFormation.with_complete_graph(rng.normal(size=(6, 3))))
    K = gains.formation.kernel_z
    u = np.linalg.qr(np.column_stack([K, rng.normal(size=(6, 1))]))[0][:, 2]
    turned = gains.z + 1.5 * np.outer(u, u)
    turned *= -4 / turned.trace()
    with pytest.raises(ValueError, match="not stable: their rate is -"):
        replace(gains, z=turned)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"graph": np.ones((6, 6))}, r"graph should be bool of shape \(6, 6\), not float64"),
        ({"graph": np.ones(3, dtype=bool)}, r"graph should be bool .* not bool of \(3,\)"),
        ({"points": np.array([["a", "b", "c"]] * 6)}, r"points should be float .* not <U1"),
        ({"points": np.arange(6.0)}, r"points should be float of shape \(6, 3\), not .* \(6,\)"),
        ({"points": np.float64(3)}, r"points should be float of shape \(0, 3\)"),
        ({"xy": np.full((6, 6), "1")}, "xy should be complex"),
        ({"z": np.ones((3, 6))}, r"z should be float of shape \(6, 6\), not float64 of \(3, 6\)"),
        ({"z": np.ones((6, 6), dtype=complex)}, "z should be float .* not complex128"),
        ({"name": np.array([1, 2])}, "name should be str"),
        ({"bounds": np.ones(3)}, r"bounds should be float of shape \(2,\), not float64 of \(3,\)"),
        ({"bounds": np.array([np.nan, 1])}, "bound_xy: must be at least .* got nan"),
        ({"bounds": np.array([1, 0.1])}, r"bound_z: must be at least the rate 0.55.* got 0.1"),
    ],
)
def test_wrong_fields_of_a_file_are_named_in_one_sentence(tmp_path, changes, words):
    path = tmp_path / "gains.npz"
    design_gains(pyramid()).save(path)
    with pytest.raises(ValueError, match=rf"^[^\n]*changed\.npz: [^\n]*{words}[^\n]*$"):
        GainMatrix.load(changed_file(path, **changes))


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
    with pytest.raises(ValueError, match=r"other\.npz is not a file of gains"):
        GainMatrix.load(path)


def test_missing_fields_are_refused_by_name(tmp_path):
    path = tmp_path / "some.npz"
    np.savez(path, points=np.zeros((3, 3)), xy=np.zeros((3, 3)))
    with pytest.raises(ValueError, match="it lacks graph, name, z, method, bounds"):
        GainMatrix.load(path)
    np.save(tmp_path / "array.npy", np.zeros(3))
    with pytest.raises(ValueError, match=r"array\.npy is not a file of gains"):
        GainMatrix.load(tmp_path / "array.npy")
