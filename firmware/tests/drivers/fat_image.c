#include "fat_image.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { PARTITION = 2048, RESERVED = 32, ROOT_ENTRIES_16 = 512, S = SD_MODEL_SECTOR };

static uint32_t u16(const uint8_t *p) { return (uint32_t)(p[0] | p[1] << 8); }
static uint32_t u32(const uint8_t *p) { return u16(p) | u16(p + 2) << 16; }
static void put16(uint8_t *p, uint32_t v) { p[0] = (uint8_t)v; p[1] = (uint8_t)(v >> 8); }
static void put32(uint8_t *p, uint32_t v) { put16(p, v); put16(p + 2, v >> 16); }

/* Where everything is, read from the boot sector. */
typedef struct {
    uint32_t bits, fat, fat_sectors, fats, data, cluster_sectors, clusters, root_cluster, root, root_sectors, fsinfo;
} layout_t;

static layout_t find_layout(const sd_model_t *card)
{
    uint8_t mbr[S], boot[S];
    layout_t at = {0};
    sd_model_peek(card, 0, mbr);
    const uint32_t start = u32(mbr + 446 + 8);
    sd_model_peek(card, start, boot);
    const uint32_t sectors = u16(boot + 19) ? u16(boot + 19) : u32(boot + 32);
    at.bits = u16(boot + 22) ? 16 : 32;
    at.fat = start + u16(boot + 14);
    at.fats = boot[16];
    at.fat_sectors = at.bits == 16 ? u16(boot + 22) : u32(boot + 36);
    at.root = at.fat + at.fats * at.fat_sectors;
    at.root_sectors = u16(boot + 17) * 32 / S;
    at.data = at.root + at.root_sectors;
    at.cluster_sectors = boot[13];
    at.clusters = (start + sectors - at.data) / at.cluster_sectors;
    at.root_cluster = at.bits == 32 ? u32(boot + 44) : 0;
    at.fsinfo = start + 1;
    return at;
}

static uint32_t get_link(const sd_model_t *card, const layout_t *at, uint32_t copy, uint32_t cluster)
{
    const uint32_t byte = cluster * at->bits / 8;
    const uint8_t *sector = sd_model_view(card, at->fat + copy * at->fat_sectors + byte / S);
    return at->bits == 32 ? u32(sector + byte % S) & 0x0FFFFFFF : u16(sector + byte % S);
}

static void set_link(sd_model_t *card, const layout_t *at, uint32_t cluster, uint32_t link)
{
    uint8_t sector[S];
    const uint32_t byte = cluster * at->bits / 8;
    for (uint32_t copy = 0; copy < at->fats; copy++) {
        const uint32_t where = at->fat + copy * at->fat_sectors + byte / S;
        sd_model_peek(card, where, sector);
        if (at->bits == 32)
            put32(sector + byte % S, link);
        else
            put16(sector + byte % S, link);
        sd_model_poke(card, where, sector);
    }
}

static uint32_t end_mark(const layout_t *at) { return at->bits == 32 ? 0x0FFFFFFF : 0xFFFF; }
static bool is_end(const layout_t *at, uint32_t link) { return link >= (at->bits == 32 ? 0x0FFFFFF8 : 0xFFF8); }

/* ---- making ---- */

static void write_boot(sd_model_t *card, const fat_image_t *image, uint32_t fat_sectors)
{
    uint8_t boot[S] = {0xEB, 0x58, 0x90, 'T', 'E', 'S', 'T', ' ', ' ', ' ', ' '};
    const uint32_t sectors = card->sectors - PARTITION;
    put16(boot + 11, S);
    boot[13] = (uint8_t)image->cluster_sectors;
    put16(boot + 14, RESERVED);
    boot[16] = 2;
    put16(boot + 17, image->bits == 16 ? ROOT_ENTRIES_16 : 0);
    boot[21] = 0xF8;
    put32(boot + 32, sectors);
    put16(boot + 24, 63);
    put16(boot + 26, 255);
    put32(boot + 28, PARTITION);
    if (image->bits == 16) {
        put16(boot + 22, fat_sectors);
        boot[38] = 0x29;
        memcpy(boot + 43, "NO NAME    FAT16   ", 19);
    } else {
        put32(boot + 36, fat_sectors);
        put32(boot + 44, 2);
        put16(boot + 48, 1);
        put16(boot + 50, 6); /* and a copy of this sector there */
        boot[66] = 0x29;
        memcpy(boot + 71, "NO NAME    FAT32   ", 19);
    }
    put16(boot + 510, 0xAA55);
    sd_model_poke(card, PARTITION, boot);
    if (image->bits == 32)
        sd_model_poke(card, PARTITION + 6, boot);
}

static void write_fsinfo(sd_model_t *card, uint32_t free_clusters)
{
    uint8_t info[S] = {0};
    put32(info, 0x41615252);
    put32(info + 484, 0x61417272);
    put32(info + 488, free_clusters);
    put32(info + 492, 2);
    put16(info + 510, 0xAA55);
    sd_model_poke(card, PARTITION + 1, info);
}

static uint32_t count_free(const sd_model_t *card, const layout_t *at)
{
    uint32_t count = 0;
    for (uint32_t cluster = 2; cluster < at->clusters + 2; cluster++)
        count += get_link(card, at, 0, cluster) == 0;
    return count;
}

static void add_entry(sd_model_t *card, const char name[11], uint32_t cluster, uint32_t bytes)
{
    const layout_t at = find_layout(card);
    const uint32_t root = at.bits == 32 ? at.data + (at.root_cluster - 2) * at.cluster_sectors : at.root;
    uint8_t sector[S];
    sd_model_peek(card, root, sector);
    uint8_t *entry = sector;
    while (*entry)
        entry += 32;
    memcpy(entry, name, 11);
    entry[11] = 0x20;
    put16(entry + 20, cluster >> 16);
    put16(entry + 26, cluster);
    put32(entry + 28, bytes);
    sd_model_poke(card, root, sector);
}

/* The filler takes the clusters after the first few, up to the last `free_clusters`. */
static void add_filler(sd_model_t *card, uint32_t free_clusters)
{
    const layout_t at = find_layout(card);
    const uint32_t first = 16, end = at.clusters + 2 - free_clusters;
    for (uint32_t cluster = first; cluster < end; cluster++)
        set_link(card, &at, cluster, cluster + 1 == end ? end_mark(&at) : cluster + 1);
    const uint64_t bytes = (uint64_t)(end - first) * at.cluster_sectors * S;
    if (bytes > 0xFFFFFFFF) /* one file could not be so large: begin it later */
        abort();
    add_entry(card, "FILLER  BIN", first, (uint32_t)bytes);
}

/* A file in as many pieces as it has clusters. */
static void add_pieces(sd_model_t *card, uint32_t free_run)
{
    const layout_t at = find_layout(card);
    const uint32_t first = 16, step = free_run + 1;
    uint32_t count = 0;
    for (uint32_t cluster = first; cluster < at.clusters + 2; cluster += step, count++)
        set_link(card, &at, cluster, cluster + step < at.clusters + 2 ? cluster + step : end_mark(&at));
    add_entry(card, "PIECES  BIN", first, count * at.cluster_sectors * S);
}

void fat_format(sd_model_t *card, const fat_image_t *image)
{
    uint8_t mbr[S] = {0};
    const uint32_t entry_bytes = (uint32_t)image->bits / 8;
    const uint32_t clusters = (card->sectors - PARTITION) / image->cluster_sectors;
    mbr[446 + 4] = image->bits == 32 ? 0x0C : 0x0E;
    put32(mbr + 446 + 8, PARTITION);
    put32(mbr + 446 + 12, card->sectors - PARTITION);
    put16(mbr + 510, 0xAA55);
    sd_model_poke(card, 0, mbr);
    write_boot(card, image, (clusters + 2) * entry_bytes / S + 1);
    const layout_t at = find_layout(card);
    set_link(card, &at, 0, end_mark(&at) & ~7u);
    set_link(card, &at, 1, end_mark(&at));
    if (image->bits == 32)
        set_link(card, &at, at.root_cluster, end_mark(&at));
    if (image->free_clusters)
        add_filler(card, image->free_clusters);
    if (image->free_run)
        add_pieces(card, image->free_run);
    if (image->bits == 32)
        write_fsinfo(card, count_free(card, &at));
}

void fat_add_file(sd_model_t *card, const char name[11], const char *text)
{
    const layout_t at = find_layout(card);
    uint8_t sector[S] = {0};
    uint32_t cluster = 3;
    while (get_link(card, &at, 0, cluster))
        cluster++;
    set_link(card, &at, cluster, end_mark(&at));
    const size_t length = strlen(text);
    memcpy(sector, text, length < S ? length : S);
    sd_model_poke(card, at.data + (cluster - 2) * at.cluster_sectors, sector);
    add_entry(card, name, cluster, (uint32_t)length);
    if (at.bits == 32)
        write_fsinfo(card, count_free(card, &at));
}

/* ---- judging ---- */

typedef struct {
    const sd_model_t *card;
    layout_t at;
    uint8_t *owned; /* a byte for each cluster */
    bool is_loud;
    int complaints;
} check_t;

static void complain(check_t *check, const char *what, const uint8_t *name, uint32_t number)
{
    check->complaints++;
    if (check->is_loud)
        fprintf(stderr, "file system: %s %.11s %u\n", what, name ? (const char *)name : "", number);
}

/* Follow a chain, take possession; its length. */
static uint32_t own_chain(check_t *check, const uint8_t *name, uint32_t first)
{
    uint32_t length = 0;
    for (uint32_t cluster = first; !is_end(&check->at, cluster);) {
        if (cluster < 2 || cluster >= check->at.clusters + 2) {
            complain(check, "chain leaves the volume or meets a free cluster", name, cluster);
            break;
        }
        if (check->owned[cluster]++) {
            complain(check, "cluster has two owners", name, cluster);
            break;
        }
        length++;
        cluster = get_link(check->card, &check->at, 0, cluster);
    }
    return length;
}

static bool is_name_good(const uint8_t *name)
{
    for (int i = 0; i < 11; i++)
        if (name[i] < 0x20 || name[i] > 0x7E || strchr("\"*+,./:;<=>?[\\]|", name[i]))
            return false;
    return name[0] != ' ';
}

static void check_entry(check_t *check, const uint8_t *entry)
{
    const uint32_t first = u16(entry + 20) << 16 | u16(entry + 26), bytes = u32(entry + 28);
    const uint32_t each = check->at.cluster_sectors * S;
    if (entry[11] & 0x08)
        return;
    if (!is_name_good(entry))
        complain(check, "bad name", entry, entry[0]);
    if (bytes == 0 && first != 0)
        complain(check, "empty file with a cluster", entry, first);
    const uint32_t length = first ? own_chain(check, entry, first) : 0;
    if (length != (uint32_t)(((uint64_t)bytes + each - 1) / each))
        complain(check, "size and chain disagree", entry, bytes);
}

static void visit_root(const sd_model_t *card, const layout_t *at, void (*visit)(void *, const uint8_t *), void *context)
{
    uint32_t cluster = at->root_cluster;
    for (uint32_t index = 0;; index++) {
        uint8_t sector[S];
        if (at->bits == 16 && index == at->root_sectors)
            return;
        if (at->bits == 32 && index && index % at->cluster_sectors == 0)
            cluster = get_link(card, at, 0, cluster);
        if (at->bits == 32 && is_end(at, cluster))
            return;
        const uint32_t where = at->bits == 16 ? at->root + index
                                              : at->data + (cluster - 2) * at->cluster_sectors + index % at->cluster_sectors;
        sd_model_peek(card, where, sector);
        for (const uint8_t *entry = sector; entry < sector + S; entry += 32) {
            if (entry[0] == 0)
                return;
            if (entry[0] != 0xE5)
                visit(context, entry);
        }
    }
}

static void visit_for_check(void *context, const uint8_t *entry) { check_entry(context, entry); }

static void check_tables(check_t *check)
{
    for (uint32_t i = 0; i < check->at.fat_sectors; i++) {
        const uint8_t *first = sd_model_view(check->card, check->at.fat + i);
        const uint8_t *second = sd_model_view(check->card, check->at.fat + check->at.fat_sectors + i);
        if (memcmp(first, second, S) != 0)
            complain(check, "the two tables differ in sector", NULL, i);
    }
}

int fat_check(const sd_model_t *card, bool is_loud)
{
    check_t check = {.card = card, .at = find_layout(card), .is_loud = is_loud};
    uint8_t info[S];
    uint32_t free_clusters = 0;
    check.owned = calloc(check.at.clusters + 2, 1);
    if (check.at.bits == 32)
        own_chain(&check, (const uint8_t *)"root       ", check.at.root_cluster);
    visit_root(card, &check.at, visit_for_check, &check);
    check_tables(&check);
    for (uint32_t cluster = 2; cluster < check.at.clusters + 2; cluster++) {
        const bool is_free = get_link(card, &check.at, 0, cluster) == 0;
        free_clusters += is_free;
        if (!is_free && !check.owned[cluster])
            complain(&check, "lost cluster", NULL, cluster);
    }
    sd_model_peek(card, check.at.fsinfo, info);
    if (check.at.bits == 32 && u32(info + 488) != 0xFFFFFFFF && u32(info + 488) != free_clusters)
        complain(&check, "count of free clusters is wrong", NULL, u32(info + 488) - free_clusters);
    free(check.owned);
    return check.complaints;
}

typedef struct {
    const layout_t *at;
    fat_file_t *files;
    size_t count, most;
} list_t;

static void visit_for_list(void *context, const uint8_t *entry)
{
    list_t *list = context;
    if (list->count == list->most || (entry[11] & 0x08))
        return;
    fat_file_t *file = &list->files[list->count++];
    memcpy(file->name, entry, 11);
    file->name[11] = '\0';
    file->first_sector = list->at->data + ((u16(entry + 20) << 16 | u16(entry + 26)) - 2) * list->at->cluster_sectors;
    file->bytes = u32(entry + 28);
}

size_t fat_list(const sd_model_t *card, fat_file_t *files, size_t most)
{
    const layout_t at = find_layout(card);
    list_t list = {.at = &at, .files = files, .most = most};
    visit_root(card, &at, visit_for_list, &list);
    return list.count;
}
