/* Little-endian integers in byte strings. */
#ifndef CORE_BYTES_H
#define CORE_BYTES_H

#include <stdint.h>

static inline void bytes_put_u16(uint8_t *out, uint16_t value)
{
    out[0] = (uint8_t)value;
    out[1] = (uint8_t)(value >> 8);
}

static inline void bytes_put_i16(uint8_t *out, int16_t value)
{
    bytes_put_u16(out, (uint16_t)value);
}

static inline void bytes_put_u32(uint8_t *out, uint32_t value)
{
    bytes_put_u16(out, (uint16_t)value);
    bytes_put_u16(out + 2, (uint16_t)(value >> 16));
}

static inline void bytes_put_u48(uint8_t *out, uint64_t value)
{
    bytes_put_u32(out, (uint32_t)value);
    bytes_put_u16(out + 4, (uint16_t)(value >> 32));
}

static inline uint16_t bytes_get_u16(const uint8_t *in)
{
    return (uint16_t)(in[0] | (uint16_t)(in[1] << 8));
}

static inline int16_t bytes_get_i16(const uint8_t *in)
{
    const int32_t value = bytes_get_u16(in);
    return (int16_t)(value < 0x8000 ? value : value - 0x10000);
}

static inline uint32_t bytes_get_u32(const uint8_t *in)
{
    return bytes_get_u16(in) | (uint32_t)bytes_get_u16(in + 2) << 16;
}

static inline int32_t bytes_get_i32(const uint8_t *in)
{
    const int64_t value = bytes_get_u32(in);
    return (int32_t)(value < INT64_C(0x80000000) ? value : value - INT64_C(0x100000000));
}

static inline uint64_t bytes_get_u48(const uint8_t *in)
{
    return bytes_get_u32(in) | (uint64_t)bytes_get_u16(in + 4) << 32;
}

#endif
