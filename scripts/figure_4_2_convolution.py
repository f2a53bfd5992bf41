"""python scripts/figure_4_2_convolution.py: a convolution computed step by step, and compared with Keras's."""

import numpy as np

from deep_contact import figures
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting
from deep_contact.studies import chapter_4 as worked


def window_products(image: np.ndarray, kernel: np.ndarray, row: int, column: int) -> np.ndarray:
    """Return the products K_ij · I_{x+i−1, y+j−1} that Eq 4.1 sums for one output, in the shape of the kernel.

    image: (n_y, n_x, ...). kernel: (k_y, k_x, ...), with the same further axes (section 4.2.2). row, column: place of
    the kernel's first element in the image, from 0. Raises ValueError unless the kernel lies within the image.
    """
    k_y, k_x = kernel.shape[:2]
    under = image[row : row + k_y, column : column + k_x]
    if row < 0 or column < 0 or under.shape != kernel.shape:
        within = f"one that lies within the image {image.shape} at ({row}, {column})"
        raise ValueError(f"kernel: expected {within}, got {kernel.shape}")
    return kernel * under


def correlate(image: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """Return the thesis's "convolution" I * K (Eq 4.1) wherever the kernel lies within the image, (o_y, o_x).

    image: (n_y, n_x) or (n_y, n_x, d). kernel: (k_y, k_x) or (k_y, k_x, d).
    """
    rows, columns = (range(n - k + 1) for n, k in zip(image.shape, kernel.shape[:2]))
    return np.array([[window_products(image, kernel, i, j).sum() for j in columns] for i in rows])


def keras_convolution(image: np.ndarray, kernel: np.ndarray, *, stride: int = 1) -> np.ndarray:
    """Return what `correlate` computes, by Keras's `Conv2D` and for f kernels at once, (o_y, o_x, f).

    image: (n_y, n_x, d). kernel: (k_y, k_x, d, f). stride: distance of neighbouring places of the kernel, in nodes.
    """
    arguments = kernel.shape[3], kernel.shape[:2]
    return worked.by_keras("Conv2D", *arguments, x=image, weights=[kernel], strides=stride, use_bias=False)


def compute(options, seed, jobs, progress):
    """Compute Eq 4.1 and 4.2 by our code, by SciPy and by Keras: for an image, the thesis's example, some strides."""
    from scipy import signal

    image, kernel = np.array(options["image"], dtype=float), np.array(options["kernel"], dtype=float)
    row, column = options["shown"]
    results = {
        "Eq 4.1": correlate(image, kernel),
        "Keras Conv2D": keras_convolution(image[..., None], kernel[..., None, None])[..., 0],
        "SciPy correlate2d": signal.correlate2d(image, kernel, mode="valid"),
        "SciPy convolve2d": signal.convolve2d(image, kernel, mode="valid"),
        "Eq 4.1, flipped kernel": correlate(image, kernel[::-1, ::-1]),
    }
    rng = np.random.default_rng(seed)
    deep_image, deep_kernel = rng.normal(size=(32, 32, 3)), rng.normal(size=(3, 3, 3, 4))
    ours = np.stack([correlate(deep_image, deep_kernel[..., f]) for f in range(4)], axis=-1)
    theirs = keras_convolution(deep_image, deep_kernel)
    example = {"one kernel": list(ours[..., :1].shape), "four kernels": list(theirs.shape)}
    sizes = []
    for n, k, s in options["sizes"]:
        by_keras = keras_convolution(np.zeros((n, n, 1)), np.zeros((k, k, 1, 1)), stride=s)
        sizes.append({"I": n, "K": k, "s": s, "Eq 4.2": (n - k) / s + 1, "Keras": by_keras.shape[0]})
    return {
        "image": image,
        "kernel": kernel,
        "shown": [row, column],
        "products": window_products(image, kernel, row, column) + 0.0,  # the sum turns −0 into 0
        "results": results,
        "example of section 4.2.2": example | {"largest difference to Keras": float(np.abs(ours - theirs).max())},
        "sizes": sizes,
    }


def claims(data):
    def apart(a, b):
        return float(np.abs(np.subtract(data["results"][a], data["results"][b])).max())

    same = {f"largest difference to {name}": apart("Eq 4.1", name) for name in ("Keras Conv2D", "SciPy correlate2d")}
    # The results are sums of a few products of small integers, so they are exact, or nearly exact.
    yield Claim("Eq 4.1 is what a convolutional layer computes", "Eq 4.1", max(same.values()) < 1e-9, same)
    plain, flipped = apart("Eq 4.1", "SciPy convolve2d"), apart("Eq 4.1, flipped kernel", "SciPy convolve2d")
    text = "what the layer computes is a cross-correlation; a convolution in terms of mathematics flips the kernel"
    measured = {"difference to SciPy's convolution": plain, "with the kernel flipped": flipped}
    yield Claim(text, "section 4.2", flipped < 1e-9 < plain, measured)
    example, sizes = data["example of section 4.2.2"], data["sizes"]
    deep = example["one kernel"] == [30, 30, 1] and example["four kernels"] == [30, 30, 4]
    text = "32 × 32 × 3 with a 3 × 3 × 3 kernel gives 30 × 30 × 1, and with n kernels 30 × 30 × n"
    yield Claim(text, "section 4.2.2", deep, example)
    fits = [(row["I"] - row["K"]) % row["s"] == 0 for row in sizes]
    equal = all(row["Eq 4.2"] == row["Keras"] for row, fit in zip(sizes, fits) if fit)
    where = "holds where the stride divides I − K; elsewhere rounded down" if equal and not all(fits) else None
    both = {"I = {I}, K = {K}, s = {s}".format(**row): f"{row['Eq 4.2']:g}, Keras {row['Keras']}" for row in sizes}
    yield Claim("Eq 4.2 gives the size of the output", "Eq 4.2", equal, both, where)
    smaller = {f"{row['I']} with K = {row['K']}, s = {row['s']}": row["Keras"] for row in sizes}
    shrinks = all(row["Keras"] < row["I"] for row in sizes)
    yield Claim("without padding each convolution makes the map smaller", "section 4.2.2", shrinks, smaller)


def draw(data, options):
    """Draw four panels: the image, the kernel, the products at one place of the kernel, and the result."""
    from matplotlib.patches import Rectangle

    row, column = data["shown"]
    k_y, k_x = np.shape(data["kernel"])
    result = data["results"]["Eq 4.1"]
    widths = [len(data["image"][0]), k_x, k_x, len(result[0])]
    figure, panels = plotting.subplots(1, 4, size=(11.0, 3.5), width_ratios=widths)
    titles = "image I", "kernel K", "products under the kernel", "I * K (Eq 4.1)"
    for ax, title, values in zip(panels, titles, (data["image"], data["kernel"], data["products"], result)):
        values = np.asarray(values)
        size = np.abs(values).max()
        shown = ax.imshow(values, cmap="cividis", vmin=-size, vmax=size)
        ax.grid(False)
        ax.set(title=title, xticks=range(values.shape[1]), yticks=range(values.shape[0]))
        ax.tick_params(length=0)
        colours = plotting.readable_on(shown.to_rgba(values))
        for (i, j), value in np.ndenumerate(values):
            ax.text(j, i, f"{value:g}", ha="center", va="center", color=colours[i, j])
    for ax, size in ((panels[0], (k_x, k_y)), (panels[3], (1, 1))):
        look = {"fill": False, "edgecolor": plotting.VERMILION, "linewidth": 2.5}
        ax.add_patch(Rectangle((column - 0.5, row - 0.5), *size, **look))
    rows = [" + ".join(f"({value:g})" if value < 0 else f"{value:g}" for value in line) for line in data["products"]]
    panels[2].set_xlabel(" +\n".join(rows) + f" = {result[row][column]:g}")
    return figure


IMAGE = [[0, 0, 1, 2, 1, 0], [0, 1, 3, 4, 2, 0], [1, 2, 5, 3, 1, 1], [0, 3, 4, 2, 0, 2], [1, 1, 2, 0, 1, 3]]
IMAGE += [[0, 0, 1, 1, 2, 4]]
KERNEL = [[1, 0, -1], [2, 1, -2], [0, 1, -1]]
"""The kernel that is shown. It has no symmetry that would hide a flip."""
SIZES = [[32, 3, 1], [61, 3, 2], [61, 2, 2], [31, 2, 1], [16, 3, 2]]
"""Cases for Eq 4.2: [edge of the image, edge of the kernel, stride], in nodes."""

OPTIONS = {"image": IMAGE, "kernel": KERNEL, "shown": [1, 2], "sizes": SIZES}
FIGURE = Figure("4.2", "A convolution worked through", compute, None, draw, claims, options=OPTIONS)
figures.run_as_script(FIGURE, __name__)
