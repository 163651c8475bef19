/* What FatFs asks of a disk, answered by the card's driver. */
#include "diskio_card.h"

#include "ff.h"

#include "diskio.h"

static sd_card_t *the_card; /* FatFs knows disks by number and has no context to hand on */

void diskio_attach(sd_card_t *card)
{
    the_card = card;
}

DSTATUS disk_status(BYTE drive)
{
    return drive == 0 && the_card && the_card->state == SD_IDLE ? 0 : STA_NOINIT;
}

DSTATUS disk_initialize(BYTE drive)
{
    return disk_status(drive);
}

DRESULT disk_read(BYTE drive, BYTE *data, LBA_t sector, UINT count)
{
    if (disk_status(drive) != 0)
        return RES_NOTRDY;
    return sd_read(the_card, sector, data, count) == SD_OK ? RES_OK : RES_ERROR;
}

DRESULT disk_write(BYTE drive, const BYTE *data, LBA_t sector, UINT count)
{
    if (disk_status(drive) != 0)
        return RES_NOTRDY;
    return sd_write(the_card, sector, data, count) == SD_OK ? RES_OK : RES_ERROR;
}

DRESULT disk_ioctl(BYTE drive, BYTE command, void *data)
{
    (void)data;
    if (disk_status(drive) != 0)
        return RES_NOTRDY;
    return command == CTRL_SYNC ? RES_OK : RES_PARERR; /* sd_write returns when the card is done */
}
