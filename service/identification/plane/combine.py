"""Step 6: rigid and flexible parts as one state space in modal form (eq. 4.9)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigvals
from scipy.optimize import linear_sum_assignment

from service.identification.arrays import Complex, Real
from service.identification.plane.model import PlaneModel


@dataclass(frozen=True)
class StateSpace:
    """Continuous time, x' = A x + B u, y = C x + D u; real poles on the diagonal, pairs as [[-s, w], [-w, -s]]."""

    A: Real
    B: Real
    C: Real
    D: Real
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def response(self, omega: Real) -> Complex:
        """Frequency response, (P, n_out, n_in)."""
        inner = 1j * omega[:, None, None] * np.eye(len(self.A)) - self.A
        return np.asarray(
            self.C @ np.linalg.solve(inner, np.broadcast_to(self.B, (len(omega), *self.B.shape))) + self.D
        )

    def document(self) -> dict[str, object]:
        """As JSON."""
        return {
            "A": self.A.tolist(),
            "B": self.B.tolist(),
            "C": self.C.tolist(),
            "D": self.D.tolist(),
            "states": list(self.states),
            "inputs": list(self.inputs),
            "outputs": list(self.outputs),
        }


def physical_matrices(model: PlaneModel) -> tuple[Real, Real, Real]:
    """A, B, C of the plant in modal coordinates of the free rotor (q, q'), with ks closed."""
    rigid_b, rigid_s = model.rigid_shapes
    m = model.modes
    phi_b = np.hstack([rigid_b, m[:, 2:4].T])
    phi_s = np.hstack([rigid_s, m[:, 4:6].T])
    n = phi_b.shape[1]
    stiffness = -phi_b.T @ (model.ks[:, None] * phi_b)
    stiffness[np.arange(2, n), np.arange(2, n)] += m[:, 0] ** 2 + m[:, 2:4] ** 2 @ model.ks
    damping = np.diag(np.concatenate([np.zeros(2), 2 * m[:, 1]]))
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])
    b = np.vstack([np.zeros((n, 2)), phi_b.T * model.ki])
    c = np.hstack([model.sensor_gain[:, None] * phi_s, np.zeros((2, n))])
    return a, b, c


def plant_poles(model: PlaneModel) -> Complex:
    """Poles of the levitated plant without controller: unstable rigid ones first, then by magnitude."""
    poles = np.linalg.eigvals(physical_matrices(model)[0])
    return np.asarray(poles[np.lexsort((-poles.imag, -poles.real, np.round(np.abs(poles), 6)))], dtype=np.complex128)


def levitated_frequencies(model: PlaneModel) -> Real:
    """Magnitude of the pole of the levitated plant that belongs to each mode, rad/s, (n,).

    The position stiffness couples the modes: on a heavy flexible rotor this is off what a mode has by itself.
    """
    nu = model.modes[:, 0]
    poles = plant_poles(model)
    size = np.abs(poles[poles.imag > 0])
    mode, pole = linear_sum_assignment(np.abs(np.log(size[None, :] / nu[:, None])))
    out = nu.copy()  # an overdamped mode has no pair
    out[mode] = size[pole]
    return out


def pole_pencil(model: PlaneModel) -> tuple[Real, Real]:
    """Matrices whose generalised eigenvalues are the poles of the levitated plant."""
    a, _, _ = physical_matrices(model)
    return a, np.eye(len(a))


def zero_pencil(model: PlaneModel) -> tuple[Real, Real]:
    """Matrices whose finite generalised eigenvalues are the plant's transmission zeros (Rosenbrock's system matrix)."""
    a, b, c = physical_matrices(model)
    n = len(a)
    pencil = np.block([[a, b / np.abs(b).max()], [c / np.abs(c).max(), np.zeros((2, 2))]])
    mass = np.zeros_like(pencil)
    mass[:n, :n] = np.eye(n)
    return pencil, mass


def transmission_zeros(model: PlaneModel) -> Complex:
    """Finite transmission zeros of the plant from coil currents to displacements."""
    values: Complex = np.asarray(eigvals(*zero_pencil(model)), dtype=np.complex128)
    values = values[np.isfinite(values)]
    limit = 50 * np.max(np.abs(plant_poles(model)))
    values = values[np.abs(values) < limit]
    return values[np.argsort(np.abs(values))]


def modal_form(
    a: Real, b: Real, c: Real, names: tuple[tuple[str, ...], tuple[str, ...]], label: str = ""
) -> StateSpace:
    """Real block-diagonal form of (A, B, C), blocks balanced; poles must be distinct.

    ``names`` are those of inputs and outputs.
    """
    values, vectors = np.linalg.eig(a)
    left = np.linalg.inv(vectors)
    order = np.lexsort((values.imag, -values.real, np.round(np.abs(values), 6)))
    blocks, columns, rows, states = [], [], [], []
    for k in order:
        p = values[k]
        if abs(p.imag) <= 1e-9 * max(abs(p), 1e-12):
            v, w = vectors[:, k].real, left[k].real
            size = _balance(w @ b, c @ v)
            blocks.append(np.array([[p.real]]))
            columns.append((v * size)[:, None])
            rows.append((w / size)[None, :])
            states.append(f"{label}real pole {p.real:.4g} rad/s")
        elif p.imag > 0:
            # x = 2 Re(v z), z' = p z: states (Re z, -Im z) give [[-s, w], [-w, -s]] with p = -s + jw
            v, w = vectors[:, k], left[k]
            size = _balance(w @ b, c @ v)
            v, w = v * size, w / size
            blocks.append(np.array([[p.real, p.imag], [-p.imag, p.real]]))
            columns.append(np.stack([2 * v.real, 2 * v.imag], axis=1))
            rows.append(np.stack([w.real, -w.imag]))
            states += [f"{label}mode {p.imag:.5g} rad/s (1)", f"{label}mode {p.imag:.5g} rad/s (2)"]
    n = sum(len(x) for x in blocks)
    out = np.zeros((n, n))
    at = 0
    for x in blocks:
        out[at : at + len(x), at : at + len(x)] = x
        at += len(x)
    t, t_inverse = np.hstack(columns), np.vstack(rows)
    return StateSpace(out, t_inverse @ b, c @ t, np.zeros((c.shape[0], b.shape[1])), tuple(states), *names)


def _balance(driven: Real | Complex, seen: Real | Complex) -> float:
    """Scale of a state that makes its input and output gains alike."""
    return float(np.sqrt(max(float(np.linalg.norm(driven)), 1e-300) / max(float(np.linalg.norm(seen)), 1e-300)))


def plant_state_space(model: PlaneModel, axes: tuple[str, str]) -> StateSpace:
    """The levitated plant from coil currents to sensed displacements in modal form, with the datasheet's sensor poles.

    Partial fractions of w/(s + w) C (sI - A)^-1 B have w C (A + wI)^-1 at the plant's states and less that times B at
    the sensor's: no eigenvectors are asked for, and two sensors may have the same pole.
    """
    a, b, c = physical_matrices(model)
    lags = [(j, float(w)) for j, w in enumerate(model.known.sensor_bandwidth_rad_s) if np.isfinite(w)]
    for j, w in lags:
        c[j] = w * np.linalg.solve((a + w * np.eye(len(a))).T, c[j])
    plant = modal_form(a, b, c, ((f"i_{axes[0]}", f"i_{axes[1]}"), (f"y_{axes[0]}", f"y_{axes[1]}")))
    for j, w in lags:
        driven, seen = -c[j] @ b, np.eye(2)[j]
        size = _balance(driven, seen)
        n = len(plant.A)
        plant = replace(
            plant,
            A=np.block([[plant.A, np.zeros((n, 1))], [np.zeros((1, n)), np.array([[-w]])]]),
            B=np.vstack([plant.B, driven * size]),
            C=np.column_stack([plant.C, seen / size]),
            states=(*plant.states, f"sensor {axes[j]} real pole {-w:.4g} rad/s"),
        )
    return plant


def amplifier_state_space(model: PlaneModel, axes: tuple[str, str]) -> StateSpace:
    """Both amplifiers, without hold and delay, in modal form."""
    parts = []
    for amp in model.amplifiers:
        poly = np.real(np.poly(amp.poles))
        n = amp.order
        a = np.zeros((n, n))
        a[0] = -poly[1:]
        a[1:, :-1] = np.eye(n - 1)
        b = np.zeros((n, 1))
        b[0] = 1.0
        c = np.zeros((1, n))
        c[0, -1] = amp.dc_gain * poly[-1]
        parts.append((a, b, c))
    n = sum(len(p[0]) for p in parts)
    a, b, c = np.zeros((n, n)), np.zeros((n, 2)), np.zeros((2, n))
    at = 0
    for j, (pa, pb, pc) in enumerate(parts):
        place = slice(at, at + len(pa))
        a[place, place], b[place, j], c[j, place] = pa, pb[:, 0], pc[0]
        at += len(pa)
    # two equal amplifiers have equal poles, but in separate blocks: take each by itself
    blocks = [modal_form(*p, (("u",), ("i",))) for p in parts]
    out_a, out_b, out_c, states = np.zeros_like(a), np.zeros_like(b), np.zeros_like(c), []
    at = 0
    for j, x in enumerate(blocks):
        place = slice(at, at + len(x.A))
        out_a[place, place], out_b[place, j], out_c[j, place] = x.A, x.B[:, 0], x.C[0]
        states += [f"amplifier {axes[j]} {s}" for s in x.states]
        at += len(x.A)
    return StateSpace(
        out_a,
        out_b,
        out_c,
        np.zeros((2, 2)),
        tuple(states),
        (f"u_{axes[0]}", f"u_{axes[1]}"),
        (f"i_{axes[0]}", f"i_{axes[1]}"),
    )


def series(first: StateSpace, second: StateSpace) -> StateSpace:
    """First, then second: amplifiers and plant, from u to y."""
    n, m = len(first.A), len(second.A)
    a = np.block([[first.A, np.zeros((n, m))], [second.B @ first.C, second.A]])
    b = np.vstack([first.B, second.B @ first.D])
    c = np.hstack([second.D @ first.C, second.C])
    return StateSpace(a, b, c, second.D @ first.D, first.states + second.states, first.inputs, second.outputs)
