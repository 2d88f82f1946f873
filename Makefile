# make demo: from nothing to tracked droplets. The other targets are described in README.md.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
PIP = $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
SEED ?= 0
SPOILT ?= 0
DEGRADED ?= $(SPOILT) # share of the training images to degrade; SPOILT is its former name
SCALE ?= small# of make reproduce: small, or paper, the paper's sizes
ARGS ?= # more options: make train ARGS=--resume, make calibrate ARGS="--size 1216x608"

.PHONY: setup dev demo dataset train-tiny train train-droplets calibrate reproduce bench soak \
	check test docs

setup: $(VENV)/.installed

# with the engine that is the fastest on CPUs, wherever there are wheels of it
$(VENV)/.installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "droptrack needs Python 3.11 or newer; name one: make PYTHON=python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(PIP) --only-binary openvino,onnx,numba,llvmlite -e '.[openvino]' || \
		{ echo "no OpenVINO for this machine: OpenCV runs the network, more slowly"; $(PIP) -e .; }
	touch $@

# everything for development, PyTorch and OpenVINO included; the exact PyTorch first, so that extras
# do not choose another build; TrackEval without its dependencies, which would install a second OpenCV
dev: $(VENV)/.dev

$(VENV)/.dev: $(VENV)/.installed
	$(PIP) torch
	$(PIP) -e '.[train,openvino,simulate,dev]'
	$(PIP) --no-deps trackeval
	touch $@

demo: setup
	$(BIN)/python -m data_gen.simulate sine --out tracks/demo --seed $(SEED)
	$(BIN)/python -m droptrack.track tracks/demo/video.avi --out tracks/demo --overwrite
	$(BIN)/python -m droptrack.evaluate tracks/demo/truth.csv tracks/demo/trajectories.csv \
		--json tracks/demo/evaluation.json
	@echo "look at tracks/demo: tracked.mp4 paths.png trajectories.csv report.json"

dataset: setup
	$(BIN)/python -m data_gen.make_dataset --scene tiny --out datasets/tiny --seed $(SEED) --degraded $(DEGRADED)
	$(BIN)/python -m data_gen.make_dataset --scene full --out datasets/full --seed $(SEED) --degraded $(DEGRADED)

train-tiny: dev dataset
	$(BIN)/python -m droptrack.train --cfg darknet_cfg/yolov3-tiny.cfg \
		--data datasets/tiny/obj.data --out runs/yolov3-tiny $(ARGS)

train: dev dataset
	$(BIN)/python -m droptrack.train --cfg darknet_cfg/yolov3.cfg \
		--data datasets/full/obj.data --out runs/yolov3 $(ARGS)

# the network that ships: docs/training.md
train-droplets: dev
	$(BIN)/python -m data_gen.make_dataset --scene all --images 24000 --seed 11 --out datasets/all
	$(BIN)/python -m droptrack.train --cfg darknet_cfg/yolov3-tiny-droplets.cfg \
		--data datasets/all/obj.data --out runs/droplets --optimizer adamw \
		--learning-rate 0.001 --window 416x224 --sizes 0.56,1.04 --batch 16 --subdivisions 1 \
		--iterations 9000 $(ARGS)

# what int8 needs, again after every training
calibrate: dev
	$(BIN)/python -m data_gen.make_dataset --scene all --images 200 --valid 300 --seed 7 \
		--out datasets/calibration
	$(BIN)/python -m droptrack.calibrate --data datasets/calibration/obj.data \
		--images 200 --checked 300 $(ARGS)

# the whole paper: reproduction/index.html, its figures and results.json; again to go on
reproduce: dev
	$(BIN)/python -m bench.reproduce --scale $(SCALE) $(ARGS)

bench: dev
	$(BIN)/python -m bench
	$(BIN)/python -m bench.engines
	$(BIN)/python -m bench.simulations
	$(PIP) --no-deps deep-sort-realtime
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m bench.trackers
	$(BIN)/python -m bench.training
	$(BIN)/python -m bench.batch

# damaged files, random bytes, killed runs: what must be survived, in under 30 minutes
soak: dev
	$(BIN)/python -m bench.soak $(ARGS)

check: dev
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

test: check
	$(BIN)/python -m pytest

# the documentation site, in site/; --strict: a broken link is an error
docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

$(VENV)/.docs: $(VENV)/.installed
	$(PIP) -e '.[docs]'
	touch $@
