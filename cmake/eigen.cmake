# Eigen from CMAKE_PREFIX_PATH or the system, else from the cmeel-eigen wheel of the Python that builds
# (also inside pip's isolated build environment, which only the interpreter itself knows).
find_package(Eigen3 3.4 QUIET NO_MODULE)
if(NOT Eigen3_FOUND)
  find_package(Python 3.11 COMPONENTS Interpreter)
  if(Python_Interpreter_FOUND)
    execute_process(
      COMMAND "${Python_EXECUTABLE}" -c
        "from importlib.metadata import distribution as d; print(d('cmeel-eigen').locate_file('cmeel.prefix'), end='')"
      OUTPUT_VARIABLE truewrench_cmeel_prefix ERROR_QUIET)
    if(truewrench_cmeel_prefix)
      list(APPEND CMAKE_PREFIX_PATH "${truewrench_cmeel_prefix}")
    endif()
  endif()
  find_package(Eigen3 3.4 REQUIRED NO_MODULE)
endif()
