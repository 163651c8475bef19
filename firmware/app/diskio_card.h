/* Which card FatFs talks to. */
#ifndef APP_DISKIO_CARD_H
#define APP_DISKIO_CARD_H

#include "sdcard.h"

void diskio_attach(sd_card_t *card);

#endif
