# CPU image; `docker run knowarm` trains two small agents, evaluates them and writes a report.
FROM python:3.12-slim
# An index with a CPU build of torch saves 4 GB of CUDA libraries on x86-64.
ARG PIP_EXTRA_INDEX_URL
RUN useradd --create-home knowarm
WORKDIR /home/knowarm
COPY pyproject.toml README.md LICENSE ./source/
COPY src ./source/src
COPY zoo/irb120-choose-answers-fast ./source/zoo/irb120-choose-answers-fast
RUN pip install --no-cache-dir torch ./source && rm -r ./source
USER knowarm
ENTRYPOINT ["knowarm"]
CMD ["demo"]
