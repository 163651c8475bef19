set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR cortex-m3)
set(CMAKE_C_COMPILER arm-none-eabi-gcc)
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
# .ci files: the call graph with each function's stack, from which build.py adds up the worst case
set(CMAKE_C_FLAGS_INIT "-mcpu=cortex-m3 -mthumb -Os -g -ffunction-sections -fdata-sections -fcallgraph-info=su")
set(CMAKE_EXE_LINKER_FLAGS_INIT "-mcpu=cortex-m3 -mthumb -nostartfiles --specs=nano.specs")
