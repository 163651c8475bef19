#include "serial.h"

#include <string.h>

enum { LINE_LONGEST = 120 };

int serial_put(serial_t *serial, const uint8_t *data, size_t length)
{
    const uint32_t put = (uint32_t)atomic_load_explicit(&serial->put, memory_order_relaxed);
    const uint32_t taken = (uint32_t)atomic_load_explicit(&serial->taken, memory_order_acquire);
    if (length > SERIAL_QUEUE - (size_t)(put - taken)) {
        serial->dropped++;
        return SERIAL_FULL;
    }
    for (size_t i = 0; i < length; i++)
        serial->bytes[(put + i) % SERIAL_QUEUE] = data[i];
    atomic_store_explicit(&serial->put, put + (uint32_t)length, memory_order_release);
    serial->kick(serial->context);
    return 0;
}

int serial_take(serial_t *serial)
{
    const uint32_t taken = (uint32_t)atomic_load_explicit(&serial->taken, memory_order_relaxed);
    if (taken == (uint32_t)atomic_load_explicit(&serial->put, memory_order_acquire))
        return -1;
    const uint8_t byte = serial->bytes[taken % SERIAL_QUEUE];
    atomic_store_explicit(&serial->taken, taken + 1, memory_order_release);
    return byte;
}

void serial_hear(serial_t *serial, uint8_t byte)
{
    static const char command[] = "selftest";
    const bool is_end = byte == '\r' || byte == '\n';
    if (is_end && serial->heard == sizeof command - 1)
        atomic_store_explicit(&serial->is_command_heard, true, memory_order_release);
    if (serial->heard < sizeof command - 1 && byte == (uint8_t)command[serial->heard])
        serial->heard++;
    else
        serial->heard = byte == (uint8_t)command[0] ? 1 : 0;
}

bool serial_is_self_test_asked(serial_t *serial)
{
    const bool is_asked = atomic_load_explicit(&serial->is_command_heard, memory_order_acquire);
    atomic_store_explicit(&serial->is_command_heard, false, memory_order_relaxed);
    return is_asked;
}

/* ---- text ---- */

typedef struct {
    char text[LINE_LONGEST];
    size_t length;
} line_t;

static void put_char(line_t *line, char c)
{
    /* FORMAT.md 7: text between frames is ASCII */
    if (line->length < sizeof line->text)
        line->text[line->length++] = (char)((unsigned char)c < 0x80 ? c : '?');
}

static void put_text(line_t *line, const char *text)
{
    while (*text)
        put_char(line, *text++);
}

static void put_number(line_t *line, uint32_t value, uint32_t base)
{
    char digits[11];
    size_t n = 0;
    do {
        digits[n++] = "0123456789abcdef"[value % base];
        value /= base;
    } while (value);
    while (n)
        put_char(line, digits[--n]);
}

static void put_signed(line_t *line, int32_t value)
{
    if (value < 0)
        put_char(line, '-');
    put_number(line, value < 0 ? 0u - (uint32_t)value : (uint32_t)value, 10);
}

static void put_argument(line_t *line, char conversion, va_list *arguments)
{
    switch (conversion) {
    case 's':
        put_text(line, va_arg(*arguments, const char *));
        break;
    case 'u':
        put_number(line, va_arg(*arguments, unsigned), 10);
        break;
    case 'x':
        put_number(line, va_arg(*arguments, unsigned), 16);
        break;
    case 'd':
        put_signed(line, va_arg(*arguments, int));
        break;
    case 'c':
        put_char(line, (char)va_arg(*arguments, int));
        break;
    default:
        put_char(line, conversion);
        break;
    }
}

int serial_print(serial_t *serial, const char *format, ...)
{
    line_t line = {.length = 0};
    va_list arguments;
    va_start(arguments, format);
    for (; *format; format++) {
        if (*format != '%' || format[1] == '\0')
            put_char(&line, *format);
        else
            put_argument(&line, *++format, &arguments);
    }
    va_end(arguments);
    return serial_put(serial, (const uint8_t *)line.text, line.length);
}
