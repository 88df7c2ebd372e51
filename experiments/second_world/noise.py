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

    @property
    def has_slow_part(self) -> bool:
        """Whether a part of it goes on from visit to visit, or sample to sample."""
        return self.kind in ("walk", "pink")


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


_SLOW = 0.25  # of the variance, in noise with a slow part


def _pink_frequencies(rows: int) -> Array:
    """Frequencies of twice as many rows, over which 1/f noise is shaped; the first as the second."""
    f = np.fft.rfftfreq(2 * rows)
    f[0] = f[1]
    return np.asarray(f, dtype=np.float64)


def _pink(rng: np.random.Generator, rows: int, columns: int) -> Array:
    """1/f noise of unit variance (rows, columns), shaped in the spectrum."""
    spectrum = np.fft.rfft(rng.standard_normal((2 * rows, columns)), axis=0)
    spectrum = spectrum / np.sqrt(_pink_frequencies(rows))[:, None]
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
    if noise.has_slow_part:
        numbers, which = np.unique(group, return_inverse=True)
        m = len(numbers)
        if noise.kind == "pink":
            slow = _pink(rng, m, shape[1])
        else:
            slow = np.cumsum(rng.standard_normal((m, shape[1])), axis=0) / np.sqrt(m / 2)
        x = np.sqrt(1.0 - _SLOW) * x + np.sqrt(_SLOW) * slow[which]
    return np.asarray(std * x)


def covariance(noise: Noise, group: Array, *, earlier: bool = False) -> Array:
    """
    Give the covariance of one column of what `draw_noise` draws.

    Parameters
    ----------
    noise
        Its kind. Heavy tails are taken as the normal noise that determines a mean as well: of t with 4 degrees of
        freedom, that of 0.7 of the variance.
    group
        Which rows (R,) share the slow part, as of `draw_noise`.
    earlier
        Whether the slow part may have begun before the table, so that its level is unknown: a walk as long ago as the
        table lasts, 1/f noise as many octaves below the table's length as the table has. Both are drawn from about
        zero.

    Returns
    -------
    Array
        In units of the variance (R, R).
    """
    own = np.eye(len(group))
    if noise.kind == "student":
        return 0.7 * own
    if not noise.has_slow_part:
        return own
    numbers, which = np.unique(group, return_inverse=True)
    place = np.arange(len(numbers))
    if noise.kind == "pink":
        product = np.fft.irfft(1.0 / _pink_frequencies(len(place)))[: len(place)]
        slow = product[np.abs(np.subtract.outer(place, place))]
        slow = slow / (product[0] - slow.mean())  # about its mean it has a variance of 1
    else:
        slow = np.minimum.outer(place + 1.0, place + 1.0) / (len(place) / 2)
    if earlier:
        slow = slow + (1.0 if noise.kind == "pink" else 2.0)
    return np.asarray((1.0 - _SLOW) * own + _SLOW * slow[np.ix_(which, which)])


def rounded(values: Array, step: Array | float) -> Array:
    """Values rounded to multiples of a step; a step of 0 leaves them as they are."""
    step = np.broadcast_to(np.asarray(step, dtype=float), values.shape)
    safe = np.where(step > 0, step, 1.0)
    return np.where(step > 0, np.round(values / safe) * safe, values)
