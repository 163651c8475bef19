/* A FAT32 or FAT16 volume on a model card, made and judged here without the code under test. */
#ifndef TESTS_FAT_IMAGE_H
#define TESTS_FAT_IMAGE_H

#include "sd_model.h"

typedef struct {
    int bits;                 /* 16 or 32 */
    uint32_t cluster_sectors;
    uint32_t free_clusters;   /* all others belong to FILLER.BIN; 0: no filler */
    uint32_t free_run;        /* so many free clusters in a row at most: each next belongs to PIECES.BIN; 0: no pieces */
} fat_image_t;

/* Make a volume, behind a partition table. */
void fat_format(sd_model_t *card, const fat_image_t *image);

/* Add a file of text to the root directory; one cluster. */
void fat_add_file(sd_model_t *card, const char name[11], const char *text);

/* What a file system check would say: 0, or the number of complaints, printed if `is_loud`. */
int fat_check(const sd_model_t *card, bool is_loud);

/* Files of the root directory. */
typedef struct {
    char name[12];
    uint32_t first_sector, bytes;
} fat_file_t;
size_t fat_list(const sd_model_t *card, fat_file_t *files, size_t most);

#endif
