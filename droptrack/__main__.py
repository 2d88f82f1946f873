"""All commands in one: ``droptrack track``, ``train``, ``evaluate`` and so on."""

from droptrack import anchors, calibrate, evaluate, export, track, train
from droptrack.command_line import new_app

app = new_app()
app.command("track")(track.main)
app.command("train")(train.main)
app.command("evaluate")(evaluate.main)
app.command("calibrate")(calibrate.main)
app.command("export")(export.main)
app.command("anchors")(anchors.main)

if __name__ == "__main__":
    app()
