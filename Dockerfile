# tactile-loc without a display. Build and run:
#
#     docker build -t tactile-loc .
#     docker run --rm -v "$PWD:/work" -v tactile-loc-store:/store tactile-loc run --out result
#
# For extras, add --build-arg EXTRAS='[learned,recordings]'. For annexes, add --build-arg ANNEXES='app library'.
FROM python:3.11-slim-bookworm

ARG EXTRAS=""
# The packages of scripts/system-packages.sh, which open3d and pyrender load. The plain package needs none of them.
RUN case "${EXTRAS}" in *all*|*icp*|*render*|*dev*) apt-get update && apt-get install -y --no-install-recommends \
        libusb-1.0-0 libegl1 libgl1 libx11-6 libudev1 libidn2-0 libgomp1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/* ;; esac

ARG ANNEXES=""
COPY pyproject.toml README.md LICENSE constraints.txt /source/
COPY tactile_loc /source/tactile_loc
COPY cli /source/cli
COPY plugins_contrib /source/plugins_contrib
RUN pip install --no-cache-dir -c /source/constraints.txt "/source${EXTRAS}" \
        $(for name in ${ANNEXES}; do echo "/source/plugins_contrib/tactile-loc-${name}"; done) \
    && tactile-loc doctor --compile

RUN useradd --create-home touch && mkdir /work /store && chown touch /work /store
USER touch
ENV TACTILE_LOC_STORE=/store
WORKDIR /work
ENTRYPOINT ["tactile-loc"]
CMD ["--help"]
