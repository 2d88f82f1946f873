"""Replays a recorded console of Darknet, and writes weights where the record says so.

FAKE_DARKNET: record, template of the weights, images an iteration, and what is to go wrong.
"""

import os
import re
import struct
import sys
import time
from pathlib import Path

LINE = re.compile(rb"^\s*(\d+): .*images")
FOR_STDERR = (b"v3 (", b" total_bbox", b"Saving weights to .")


def main() -> None:
    record, template, batch, trouble = os.environ["FAKE_DARKNET"].split(os.pathsep)
    lines = Path(record).read_bytes().splitlines(keepends=True)
    hank = "hank" in Path(record).name
    out, err = sys.stdout.buffer, sys.stderr.buffer
    if sys.argv[1:] == ["version"]:
        out.write(lines[0] if hank else b"Not an option: version\n")
        return
    assert sys.argv[1:5] == ["detector", "train", "obj.data", sys.argv[4]]
    assert Path("obj.data").exists()
    assert ("-nocolour" in sys.argv) == hank
    Path("pid").write_text(str(os.getpid()))
    with_map, iteration = "-map" in sys.argv, 0
    if sys.argv[5].endswith(".weights") and "-clear" not in sys.argv:
        iteration = struct.unpack_from("<Q", Path(sys.argv[5]).read_bytes(), 12)[0] // int(batch)
    done, in_map = iteration, False
    for line in lines:
        if found := LINE.match(line):
            iteration = int(found[1])
        in_map = in_map and not LINE.match(line) and not line.startswith(b"Loaded")
        in_map = in_map or b"alculation mAP" in line or b"alculating mAP" in line
        in_map = in_map and b"_last.weights" not in line and b"_final.weights" not in line
        if iteration <= done and iteration > 0:
            continue
        if in_map and not with_map:
            continue
        if in_map and trouble == "last map" and iteration == 310:
            os.abort()
        (err if line.startswith(FOR_STDERR) else out).write(line)
        out.flush()
        err.flush()
        if line.startswith(b'Type "yes"') and trouble != "silent":
            assert sys.stdin.readline() == "yes\n"
        if found := re.match(rb"Saving weights to (\S+)", line):
            whole = Path(template).read_bytes()
            seen = struct.pack("<Q", iteration * int(batch))
            Path(found[1].decode()).write_bytes(whole[:12] + seen + whole[20:])
        go_wrong(trouble, iteration, with_map)
    if trouble == "end":
        os.abort()


def go_wrong(trouble: str, iteration: int, with_map: bool) -> None:
    """Do what the test is about."""
    if trouble == "map" and with_map and iteration == 100:
        os.abort()
    if trouble == "killed" and iteration == 201:
        sys.stderr.write("CUDA Error: out of memory\n")
        sys.stderr.flush()
        os._exit(1)
    if trouble == "torn" and iteration == 201:
        last = next(Path().glob("*_last.weights"))
        last.write_bytes(last.read_bytes()[:-400])
        os._exit(1)
    if trouble == "hang" and iteration == 201:
        time.sleep(60)
    if trouble == "garbage":
        sys.stdout.buffer.write(
            b"\xff\xfe\x00 12: x, 99: loss=, mean average precision (mAP@0.50) = \x1b[2J\n"
        )
        sys.stdout.buffer.write(
            b"Region " * 2000 + b"\r 3000: 1.0, 1.0 avg loss, 1 rate, 1 seconds, 1 images\n"
        )
    if trouble == "slow":
        time.sleep(0.02)


main()
