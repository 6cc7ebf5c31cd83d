# One image for every process: `docker build -t dynpf .`, or compose.yaml. Where packages come through a private certificate
# authority, put its certificates into ca-certificates.pem beside this file; they stay out of the image.
# The base is pinned by the digest of Docker Hub's index of 2026-10-01; BASE names another, such as a mirror's.
ARG BASE=python:3.11-slim-bookworm@sha256:a36c24f9cbdf4fd0f52d67f0823eeac19c2028c637cecc392d97f980d4fec56b

FROM ${BASE} AS build
WORKDIR /build
RUN python3 -m venv --without-pip /opt/dynpf
COPY requirements.lock ca-certificates.pem* ./
RUN if [ -f ca-certificates.pem ]; then export PIP_CERT=/build/ca-certificates.pem; fi \
    && pip --python /opt/dynpf/bin/python install --no-cache-dir --require-hashes --requirement requirements.lock
COPY pyproject.toml README.md LICENSE ./
COPY dynpf dynpf
COPY protocol protocol
COPY formats formats
COPY runtime runtime
COPY services services
COPY experiments experiments
COPY systems systems
COPY lab lab
COPY scenarios scenarios
RUN pip --python /opt/dynpf/bin/python install --no-cache-dir --no-index --no-deps --no-build-isolation . ./lab

FROM ${BASE}
RUN useradd --system --no-create-home dynpf && install --directory --owner=dynpf /dynpf/runs /var/cache/dynpf
COPY --from=build /opt/dynpf /opt/dynpf
ENV PATH=/opt/dynpf/bin:$PATH PYTHONSAFEPATH=1 PYTHONUNBUFFERED=1 NUMBA_CACHE_DIR=/var/cache/dynpf
USER dynpf
WORKDIR /dynpf
# What the scenarios need of the kernels is compiled into the image. Another kind of processor compiles anew when it runs.
RUN for scenario in parts-3-easy parts-3-tracked landmark-room; do \
        dynpf run $scenario --set max_ticks=20 --runner inline --no-page --output /tmp/warm.mcap && rm /tmp/warm.mcap; done
ENTRYPOINT ["dynpf"]
CMD ["--help"]
