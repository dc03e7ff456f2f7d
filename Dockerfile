# trueup beside a robot: networks, policies and the bridge to ROS 2, without torch. docs/realtime.md says how to run it.
#   docker build -t trueup .
#   docker build -t trueup --build-arg EXTRAS=plan,learn,ros2 .    # to record and train in it, too
FROM python:3.11-slim-bookworm
ARG EXTRAS=run,ros2
RUN apt-get update && apt-get install -y --no-install-recommends libgl1 libglib2.0-0 && rm -rf /var/lib/apt/lists/*
WORKDIR /opt/trueup
COPY pyproject.toml requirements.lock README.md LICENSE ./
COPY src ./src
RUN python -m venv /opt/venv
RUN /opt/venv/bin/pip install --no-cache-dir --disable-pip-version-check -c requirements.lock ".[$EXTRAS]"
ENV PATH=/opt/venv/bin:$PATH
WORKDIR /data
ENTRYPOINT ["trueup"]
CMD ["doctor"]
