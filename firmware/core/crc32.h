/* CRC-32 as in zlib. */
#ifndef CORE_CRC32_H
#define CORE_CRC32_H

#include <stddef.h>
#include <stdint.h>

/* CRC of `length` more bytes after those that gave `crc`; start with 0. */
uint32_t crc32_update(uint32_t crc, const uint8_t *data, size_t length);

#endif
