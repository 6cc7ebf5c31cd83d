// How Chromium is started: without a sandbox, as root in a container has none, and without a word to anybody.

export const FLAGS = [
  "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
  "--disable-component-update", "--disable-sync",
];
