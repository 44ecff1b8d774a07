"""Find, read, write and publish models: by name, file or Hugging Face id, in every known layout."""
