# CPU:   docker build -t std-toolkit .
# CUDA:  docker build -t std-toolkit:cuda --build-arg BASE=nvidia/cuda:12.8.1-runtime-ubuntu24.04 \
#            --build-arg EXTRAS=train .
# Use:   docker run --rm -v "$PWD:/data" -w /data std-toolkit std-restore rec/ --out restored/ ...
# A preview or the web annotator needs its port: -p 8090:8090, --web 8090 (see docs/install.md).
ARG BASE=python:3.12-slim-bookworm
FROM ${BASE}

# Extras of pyproject.toml, comma-separated.
ARG EXTRAS=restore,ros,web
# Index of torch's wheels; the default of PyPI brings CUDA on Linux.
ARG TORCH_INDEX=

ENV DEBIAN_FRONTEND=noninteractive PIP_NO_CACHE_DIR=1 PYTHONDONTWRITEBYTECODE=1
# Bases without Python (nvidia/cuda) get that of the distribution. EGL and OSMesa render without a
# display, X libraries are what Open3D and Qt load.
RUN apt-get update \
    && (command -v python3 >/dev/null || apt-get install -y --no-install-recommends python3 python3-venv) \
    && apt-get install -y --no-install-recommends libegl1 libgl1 libgles2 libgomp1 libosmesa6 libx11-6 \
        libxext6 libxrender1 libsm6 libglib2.0-0 libxkbcommon0 \
    && rm -rf /var/lib/apt/lists/*

RUN python3 -m venv /opt/std && /opt/std/bin/python -m pip install --quiet --upgrade pip
ENV PATH=/opt/std/bin:$PATH PYOPENGL_PLATFORM=egl
COPY . /src
RUN if [ -n "$TORCH_INDEX" ]; then pip install torch --index-url "$TORCH_INDEX"; fi \
    && pip install "/src[$EXTRAS]" && std-curate --version && rm -rf /src
WORKDIR /data
CMD ["std-restore", "--help"]
