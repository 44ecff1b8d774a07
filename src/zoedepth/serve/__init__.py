"""A page in the browser and a REST service, in one process that keeps nothing: `zoedepth serve`.

    settings = Settings(models=("zoed-lite",))
    run(create_app(settings), settings, bind("127.0.0.1", 8000))

A request goes through these in turn: ``guard`` (who may ask, and how much may be sent), ``body`` (its parts, in
memory), ``photos`` (what the photo's header says), ``gate`` (whose turn it is), ``engine`` (the model), ``answers``
(the file).
"""
