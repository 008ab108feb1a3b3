# make run | test | lint | docs: each sets .venv up when it is missing or out of date.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready
TESTS ?= -n $$(($(WORKERS))) --dist worksteal  # neighbours share what they compare with
WORKERS = 2 * $$(nproc)  # many wait for programs

KILLS ?= 200
THIRD_PARTY ?= ../shared/third-party
unexport PYTHONDONTWRITEBYTECODE  # each program would compile again all that it imports

.PHONY: environment run test long thorough attacks fuzz programs product vmas browser robots rest chaos faults machines units kills stage bits-everywhere lint format docs docs-commands reference bench bench-quick bench-methods bench-noise benchmarks paper scale soak clean

run: $(READY)
	$(BIN)/zswarm-ot run $(or $(ARGS),stadium)

test: WORKERS = 3 * $$(nproc) / 2
test: $(READY)
	$(BIN)/python -m pytest $(TESTS) $(ARGS)

long: $(READY)
	$(BIN)/python -m pytest $(TESTS) -m long $(ARGS)

# The same once more with much more of it, before a release; in the environment that has all packages.
thorough: build/vmas/ready
	build/vmas/bin/python -m pytest $(TESTS) -m thorough $(ARGS)

# Attacks on the real programs, on loopback.
attacks: $(READY)
	$(BIN)/python -m pytest $(TESTS) -m attacks $(ARGS)

# Mutated messages to a server and optimizers, for so long: make fuzz SECONDS=1800.
fuzz: $(READY)
	FUZZ_SECONDS=$(or $(SECONDS),60) $(BIN)/python -m pytest -n 3 -rP -m attacks tests/attacks/test_fuzz.py $(ARGS)

# Servers and optimizers as real programs.
programs: $(READY)
	$(BIN)/python -m pytest $(TESTS) -m programs $(ARGS)

# Every combination of simulators, networks, optimizers and rankings, with real programs.
product: $(READY)
	$(BIN)/python -m pytest $(TESTS) -m product $(ARGS)

# Scenarios of VMAS, and runs for MLflow and Weights & Biases, in an environment of their own: these are large.
vmas: build/vmas/ready
	build/vmas/bin/python -m pytest -m "vmas and not thorough" tests/sims/adapters/test_vmas.py tests/ot/analysis/test_trackers.py $(ARGS)

# Dashboard and player in a real browser (Debian: apt install chromium-headless-shell, or chromium).
browser: $(READY)
	$(BIN)/python -m pytest $(TESTS) -m browser $(ARGS)

# ROS 1 (Debian: apt install ros-core), ROS 2, compilers and other processors: exports are compiled, ROS simulations run.
robots: $(READY)
	$(BIN)/python -m pytest $(TESTS) -m "robots and not thorough" $(ARGS)

# The benchmarks in their quick form: whether they work.
benchmarks: $(READY)
	$(BIN)/python -m pytest $(TESTS) -m benchmarks $(ARGS)

# All of these but vmas, machines and product, in one go: tests that wait run next to tests that compute.
rest: $(READY)
	$(BIN)/python -m pytest $(TESTS) -m "(long or programs or browser or robots or faults or docs or benchmarks or attacks) and not thorough" $(ARGS)

chaos: $(READY)
	$(BIN)/python -m tests.chaos $(if $(SEED),--seed $(SEED)) $(if $(SECONDS),--seconds $(SECONDS))

# Real faults with real programs; they wait for timeouts most of the time.
faults: $(READY)
	$(BIN)/python -m pytest $(TESTS) -m faults $(ARGS)

# docs/deploy.md on systems that are booted for it: root, systemd-nspawn.
machines: $(READY)
	$(BIN)/python -m pytest -m machines tests/integration/test_machines.py $(ARGS)

# The real Stage, built where its sources are beside the checkout; its tests are skipped where they are not. So many resets: make stage RESETS=2000.
stage: $(READY)
	@if [ ! -e $(THIRD_PARTY)/stage-4.3.tar.xz ]; then echo "Stage is not built: no sources in $(THIRD_PARTY)"; \
	elif ! command -v cmake g++ fluid catkin_make >/dev/null; then echo "Stage is not built: cmake, g++, fluid or catkin is missing"; \
	else $(MAKE) --no-print-directory build/stage/ready; fi
	RESETS=$(or $(RESETS),10) $(BIN)/python -m pytest -m stage tests/ros/stage $(ARGS)

# What systemd says of the units.
units: $(READY)
	deploy/check-units.sh $(BIN)

# So many kills during one run.
kills: $(READY)
	KILLS=$(KILLS) $(BIN)/python -m pytest -s -m faults tests/integration/test_kills.py $(ARGS)

# Results with the oldest and newest Python, numpy and numba; those between them are with make thorough.
bits-everywhere: $(READY)
	$(BIN)/python -m pytest -m "versions and not thorough" tests/bits $(ARGS)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# The site, in build/docs; every warning is an error.
docs: $(READY)
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --nitpicky --quiet -b html -d build/docs-cache docs build/docs
	@echo build/docs/index.html

# Every command that a document shows, in its order, the code of docs/python.md and the notebook.
docs-commands: $(READY)
	$(BIN)/python -m pytest $(TESTS) -m docs $(ARGS)

# The parts of the documents that are made from the code.
reference: $(READY)
	$(BIN)/python docs/reference.py

# Everything, and docs/benchmarks.md made from it: half an hour. Others are in an environment of their own: nothing of theirs comes
# into .venv.
bench: $(READY) build/peers/ready
	$(BIN)/python benchmarks/bench.py $(ARGS)

# Ratios beside those that are checked in.
bench-quick: $(READY)
	$(BIN)/python benchmarks/ratios.py $(ARGS)

# Learning curves of the optimizers, and docs/benchmarks.md with them.
bench-methods: $(READY)
	$(BIN)/python benchmarks/bench.py --only methods $(ARGS)

# What runs report and what their champions do, and docs/benchmarks.md with it: some minutes of computing.
bench-noise: $(READY)
	$(BIN)/python benchmarks/bench.py --only noise $(ARGS)

# The paper's designs beside zswarm's ways, and docs/paper.md with them: a quarter of an hour; mosquitto (Debian: apt install mosquitto).
paper: $(READY)
	cd benchmarks && ../$(BIN)/python -m paper $(ARGS)

scale: $(READY)
	cd benchmarks && ../$(BIN)/python -m scale $(ARGS)

soak: $(READY)
	$(BIN)/python benchmarks/soak.py $(ARGS)

clean:
	rm -rf .venv build .pytest_cache .mypy_cache .ruff_cache

# uv where it is there, else venv and pip; what the machine lacks is named with the package that has it.
$(READY): pyproject.toml Makefile
	@command -v $(PYTHON) >/dev/null || { echo "python3 is missing: install Python 3.11 or newer (Debian: apt install python3 python3-venv)"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "$$($(PYTHON) --version) is too old: install Python 3.11 or newer, or say make PYTHON=python3.12"; exit 1; }
	@$(MAKE) --no-print-directory environment FOLDER=.venv PACKAGES="--editable '.[dev]'"
	@touch $@

# An environment in FOLDER with PACKAGES: uv makes it in a tenth of the time that pip takes.
environment:
	@if command -v uv >/dev/null; then \
	    uv venv --quiet --seed --allow-existing --python $(PYTHON) $(FOLDER) && uv pip install --quiet --python $(FOLDER)/bin/python $(PACKAGES); \
	else \
	    $(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo "the venv module is missing: install it (Debian: apt install python3-venv)"; exit 1; }; \
	    $(PYTHON) -m venv $(FOLDER) && $(FOLDER)/bin/python -m pip install --quiet --disable-pip-version-check $(PACKAGES); \
	fi

# One release of torch, so that its build without graphics (+cpu) is taken where there is one.
build/vmas/ready: pyproject.toml Makefile
	@$(MAKE) --no-print-directory environment FOLDER=build/vmas PACKAGES="--editable '.[dev,mlflow,vmas,wandb]' 'torch==2.13.*'"
	@touch $@

# rclpy has an environment of its own: it starts each of its programs twice. Without a build for this machine there is none.
build/ros2/ready: Makefile
	@$(MAKE) --no-print-directory environment FOLDER=build/ros2 PACKAGES="'ros-kilted-rclpy[fastrtps]==9.1.2' \
	    ros-kilted-geometry-msgs==5.5.1 ros-kilted-sensor-msgs==5.5.1 ros-kilted-nav-msgs==5.5.1 ros-kilted-rosgraph-msgs==2.3.0 ros-kilted-std-srvs==5.5.1" \
	    || { rm -rf build/ros2; exit 1; }
	@touch $@

# Stage, stageros and our controllers for them: a minute of computing.
build/stage/ready: tests/ros/stage/build.sh examples/ros/stage/throttle.cc examples/ros/stage/lockstep.cc
	@mkdir -p build
	tests/ros/stage/build.sh $(THIRD_PARTY) build/stage > build/stage.log 2>&1 || { tail -n 5 build/stage.log; rm -rf build/stage; exit 1; }

# Each peer by itself; what pip said of one that cannot be installed is shown in its place, and it is tried again next time.
build/peers/ready: pyproject.toml benchmarks/requirements.txt
	@$(MAKE) --no-print-directory environment FOLDER=build/peers PACKAGES="--editable ."
	@rm -f build/peers/*.refused
	@grep -v '^#' benchmarks/requirements.txt | while read -r peer; do \
	    name=$$(echo "$$peer" | sed 's/[^a-z0-9-].*//'); echo "installing $$peer"; \
	    build/peers/bin/python -m pip install --quiet --disable-pip-version-check $$peer 2> build/peers/said || \
	        { grep '^ERROR' build/peers/said | tail -n 1 > "build/peers/$$name.refused"; cat "build/peers/$$name.refused"; }; \
	done
	@build/peers/bin/python -m compileall -qq -j 0 build/peers/lib || true  # uv does not, and times would have it
	@ls build/peers/*.refused >/dev/null 2>&1 || touch $@
