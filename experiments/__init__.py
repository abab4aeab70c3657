"""One script a figure or sweep: run(config) -> history, plot(history, path), main()."""
