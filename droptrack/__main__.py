"""All commands in one: ``droptrack track``, ``train``, ``evaluate`` and so on."""

from droptrack.anchors import main as anchors
from droptrack.batch import main as batch
from droptrack.calibrate import main as calibrate
from droptrack.command_line import new_app
from droptrack.convert import main as convert
from droptrack.detect import main as detect
from droptrack.evaluate import main as evaluate
from droptrack.events import main as events
from droptrack.export import main as export
from droptrack.track import main as track
from droptrack.train import main as train

app = new_app()
app.command("track")(track)
app.command("batch")(batch)
app.command("detect")(detect)
app.command("train")(train)
app.command("convert")(convert)
app.command("evaluate")(evaluate)
app.command("events")(events)
app.command("calibrate")(calibrate)
app.command("export")(export)
app.command("anchors")(anchors)

if __name__ == "__main__":
    app()
