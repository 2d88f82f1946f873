"""Command: videos of moving droplets with their exact truth, ``python -m data_gen.simulate``."""

from data_gen.lattice_boltzmann.constriction import constriction
from data_gen.lattice_boltzmann.shear import shear
from data_gen.videos.motions import motions
from data_gen.videos.sine import sine
from droptrack.command_line import new_app, one_line_errors

app = new_app()


@app.callback()
def main() -> None:
    """Write video.avi and truth.csv of droplets whose paths are known exactly."""


app.command()(one_line_errors(sine))
app.command()(one_line_errors(shear))
app.command()(one_line_errors(constriction))
app.command()(one_line_errors(motions))

if __name__ == "__main__":
    app()
