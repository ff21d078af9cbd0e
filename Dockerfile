# CPU image; `docker run knowarm` trains two small agents, evaluates them and writes a report.
FROM python:3.12-slim
# An index with a CPU build of torch saves 4 GB of CUDA libraries on x86-64.
ARG PIP_EXTRA_INDEX_URL
RUN useradd --create-home knowarm
WORKDIR /home/knowarm
COPY pyproject.toml README.md LICENSE ./source/
COPY src ./source/src
RUN pip install --no-cache-dir torch==2.13.0 ./source && rm -r ./source
USER knowarm
ENTRYPOINT ["knowarm"]
CMD ["demo"]
