# docker build -t beltrami .
# docker run --rm -v "$PWD:/data" beltrami smooth scan.ply clean.ply
FROM python:3.12-slim AS build
RUN apt-get update && apt-get install --yes --no-install-recommends g++
COPY . /source
RUN python -m venv /opt/beltrami && /opt/beltrami/bin/pip install --no-cache-dir '/source[usd,volumes]'

FROM python:3.12-slim
COPY --from=build /opt/beltrami /opt/beltrami
ENV PATH="/opt/beltrami/bin:$PATH"
WORKDIR /data
ENTRYPOINT ["beltrami"]
