/* Results of core functions: 0 or a count, or one of these. */
#ifndef CORE_ERROR_H
#define CORE_ERROR_H

enum {
    CORE_OK = 0,
    CORE_NO_ROOM = -1,   /* the ring is full; the loss was counted */
    CORE_INVALID = -2,   /* bytes that are no block, frame, record or setting */
    CORE_TOO_LONG = -3,  /* does not fit into a record */
    CORE_DEVICE = -4     /* the caller's read function failed */
};

#endif
