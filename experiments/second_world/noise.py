"""Noise of instruments and of torque signals, by name."""

from dataclasses import dataclass

import numpy as np

from experiments.second_world.arrays import Array, stream

__all__ = ["NOISES", "Noise", "choose_noise", "covariance", "draw_noise", "rounded"]


@dataclass(frozen=True)
class Noise:
    """Noise of measurements; standard deviations are of the total noise of any kind."""

    kind: str  # "white", "walk" (white and a random walk), "pink" (white and 1/f), "student" (t, 4 degrees of freedom)
    instrument: str
    position_std_m: float
    axes: tuple[float, float, float] = (1.0, 1.0, 1.0)  # factors on the axes of the instrument's frame
    looks_along_z: bool = False
    count_rad: float = 0.0  # step of the encoders in the reported angles; 0: none
    position_step_m: float = 0.0
    torque_step: float = 0.0  # step of the torque signal over its standard deviation


NOISES: dict[str, Noise] = {
    "white": Noise("white", "laser tracker", 3.0e-5),
    "walk": Noise("walk", "laser tracker", 4.0e-5),
    "pink": Noise("pink", "optical CMM", 5.0e-5),
    "student": Noise("student", "laser tracker", 3.5e-5),
    "quantised": Noise(
        "white", "draw-wire frame", 5.0e-5, count_rad=2 * np.pi / 2**20, position_step_m=5.0e-5, torque_step=2.0
    ),
    "stereo": Noise("white", "stereo camera", 6.0e-5, axes=(0.6, 0.6, 2.4), looks_along_z=True),
}


def choose_noise(name: str | None, seed: int) -> tuple[str, Noise]:
    """
    Look up a noise, or choose one by seed.

    Parameters
    ----------
    name
        One of `NOISES`; None chooses.
    seed
        What the choice follows from.

    Returns
    -------
    tuple
        Its name, and the noise.
    """
    if name is None:
        name = str(stream(seed, "choice of noise").choice(sorted(NOISES)))
    if name not in NOISES:
        raise ValueError(f"noise {name!r}: expected one of {', '.join(NOISES)}")
    return name, NOISES[name]


def _pink(rng: np.random.Generator, rows: int, columns: int) -> Array:
    """1/f noise of unit variance (rows, columns), shaped in the spectrum."""
    f = np.fft.rfftfreq(2 * rows)
    f[0] = f[1]
    spectrum = np.fft.rfft(rng.standard_normal((2 * rows, columns)), axis=0) / np.sqrt(f)[:, None]
    x = np.fft.irfft(spectrum, axis=0)[:rows]
    return np.asarray(x / x.std(axis=0))


def draw_noise(noise: Noise, std: Array, group: Array, rng: np.random.Generator) -> Array:
    """
    Draw the noise of a table.

    Parameters
    ----------
    noise
        Its kind.
    std
        Standard deviation of each column (c,).
    group
        Which rows (R,) share the slow part: the number of a visit, or of a sample; not falling.
    rng
        Source of the numbers.

    Returns
    -------
    Array
        Noise (R, c). A slow part has a quarter of the variance over the whole table.
    """
    shape = (len(group), len(std))
    if noise.kind == "student":
        return np.asarray(std * rng.standard_t(4, shape) / np.sqrt(2.0))
    x = rng.standard_normal(shape)
    if noise.kind in ("walk", "pink"):
        numbers, which = np.unique(group, return_inverse=True)
        m = len(numbers)
        if noise.kind == "pink":
            slow = _pink(rng, m, shape[1])
        else:
            slow = np.cumsum(rng.standard_normal((m, shape[1])), axis=0) / np.sqrt(m / 2)
        x = np.sqrt(0.75) * x + 0.5 * slow[which]
    return np.asarray(std * x)


def covariance(noise: Noise, count: int) -> Array:
    """
    Give the covariance of one column's noise over visits or samples, but for its steps.

    Parameters
    ----------
    noise
        Its kind. Heavy tails are taken as the normal noise that determines a mean as well: of t with 4 degrees of
        freedom, that of 0.7 of the variance.
    count
        How many visits or samples there are.

    Returns
    -------
    Array
        In units of the variance (count, count).
    """
    if noise.kind == "student":
        return 0.7 * np.eye(count)
    if noise.kind == "pink":
        f = np.fft.rfftfreq(2 * count)
        f[0] = f[1]
        product = np.fft.irfft(1.0 / f)[:count]
        place = np.arange(count)
        slow = product[np.abs(np.subtract.outer(place, place))]
        return np.asarray(0.75 * np.eye(count) + 0.25 * slow / (product[0] - slow.mean()))  # about its mean it has 1
    if noise.kind == "walk":
        steps = np.arange(1, count + 1) / (count / 2)
        return np.asarray(0.75 * np.eye(count) + 0.25 * np.minimum.outer(steps, steps))
    return np.eye(count)


def rounded(values: Array, step: Array | float) -> Array:
    """Values rounded to multiples of a step; a step of 0 leaves them as they are."""
    step = np.broadcast_to(np.asarray(step, dtype=float), values.shape)
    safe = np.where(step > 0, step, 1.0)
    return np.where(step > 0, np.round(values / safe) * safe, values)
