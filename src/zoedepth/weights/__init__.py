"""Where models come from: by name, file or Hugging Face id, in any layout that is known."""
